"""Problems of unbounded media, computed beside their exact solutions: one module a kind of problem."""

from farhorizon.studies.collection import Collection

VALIDATIONS = Collection(
    "validate",
    "farhorizon.validation",
    (
        "nonlocal_waves",
        "moving_load",
        "explosion",
        "surface_motion",
        "cross_sections",
        "stress_intensity",
        "crack_impact",
        "lattice_crack",
        "pressurised",
        "penny",
        "dissolution",
        "thermal_shock",
        "branching",
        "fracture_energy",
    ),
    "exact",
)
#: Decorator that enters a function into the list.
validation = VALIDATIONS.enter
