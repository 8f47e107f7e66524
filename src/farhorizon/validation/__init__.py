"""Problems in unbounded media with known exact solutions."""

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
        "fracture_energy",
    ),
    "exact",
)
#: Decorator that registers a function as a validation.
validation = VALIDATIONS.enter
