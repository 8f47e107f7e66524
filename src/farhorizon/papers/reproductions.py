"""Published tables and figures, computed anew: one module a paper, each result beside the printed one."""

from farhorizon.studies.collection import Collection

REPRODUCTIONS = Collection(
    "reproduce",
    "farhorizon.papers",
    ("bobaru2010", "hermann2023", "ji2021", "shojaei2020", "shojaei2020_corrosion", "wildman2012"),
    "printed",
)
#: Decorator that enters a function into the list.
reproduction = REPRODUCTIONS.enter
