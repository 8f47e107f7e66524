"""Problems of unbounded media, computed beside their exact solutions: one module a kind of problem."""

from farhorizon.studies.collection import Collection

VALIDATIONS = Collection(
    "validate",
    "farhorizon.validation",
    (
        "nonlocal_waves",
        "moving_load",
        "explosion",
        "pressed_cavity",
        "surface_motion",
        "cross_sections",
        "stress_intensity",
        "crack_impact",
        "lattice_diffraction",
        "lattice_fracture",
        "pressurised",
        "penny",
        "dissolution",
        "thermal_shock",
        "branching",
        "branching_patterns",
        "fracture_energy",
    ),
    "exact",
)
#: Decorator that enters a function into the list.
validation = VALIDATIONS.enter
