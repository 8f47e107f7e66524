"""Published tables and figures recomputed: one module per paper, with each result next to the printed one."""

from farhorizon.studies.collection import Collection

REPRODUCTIONS = Collection(
    "reproduce",
    "farhorizon.papers",
    ("bobaru2010", "hermann2023", "ji2021", "shojaei2020", "shojaei2020_corrosion", "wildman2012"),
    "printed",
    0.05,
)
#: Decorator that registers a function as a reproduction.
reproduction = REPRODUCTIONS.enter

#: Width of a drawn line relative to the height of a picture: curves that differ by less look the same in a figure.
LINE = 0.01
#: Difference relative to the range of a map of colours that cannot be seen: readers tell some twenty shades apart.
SHADE = 0.05
