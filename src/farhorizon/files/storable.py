"""Classes whose objects are stored in files as plain data: the class name and the arguments of the constructor."""

from __future__ import annotations

from typing import Any, ClassVar


class Storable:
    """A component of a set-up other than a model or a side: a class that derives from it is registered for checkpoints.

    Its objects store each argument of the constructor as an attribute of the same name.

    Attributes
    ----------
    stored_as : dict of str to type
        All such classes by name, including user-defined ones.

    Raises
    ------
    TypeError
        When a class is defined with the name of a class of another module.

    Examples
    --------
    >>> import farhorizon as fh
    >>> from farhorizon.files.storable import Storable
    >>> Storable.stored_as["Disc"] is fh.Disc
    True
    """

    stored_as: ClassVar[dict[str, type[Storable]]] = {}

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        known = Storable.stored_as.get(cls.__name__)
        if known is not None and known.__module__ != cls.__module__:
            raise TypeError(
                f"there is a class {cls.__name__!r} already, in {known.__module__}: give yours another name"
            )
        Storable.stored_as[cls.__name__] = cls
