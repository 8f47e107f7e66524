"""Docstrings of all public names: each name and each of its members has one, and the examples give what they say."""

import doctest
import inspect

import pytest

import farhorizon as fh


@pytest.mark.parametrize("name", sorted(fh.__all__))
def test_example(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for family in {base for each in fh.__all__ for base in getattr(getattr(fh, each), "__mro__", ())}:
        if "known" in vars(family):  # classes of the examples are not offered to other tests
            monkeypatch.setattr(family, "known", dict(family.known))
    text = inspect.getdoc(getattr(fh, name))
    found = doctest.DocTestParser().get_doctest(text, {}, name, None, None)
    assert any(example.source.startswith("import farhorizon as fh") for example in found.examples)
    said = []
    assert doctest.DocTestRunner().run(found, out=said.append).failed == 0, "".join(said)


def undocumented(name):
    """Yield the public methods and properties of a public name, including those inherited from this package, that
    have no docstring.
    """
    thing = getattr(fh, name)
    for member, value in inspect.getmembers(thing) if inspect.isclass(thing) else ():
        given = value.fget if isinstance(value, property) else value
        ours = (getattr(given, "__module__", None) or "").startswith("farhorizon")
        if not member.startswith("_") and ours and callable(given) and not _text(thing, member):
            yield f"{name}.{member}"
    if not (thing.__doc__ or "").strip():
        yield name


def _text(thing, member):
    """Return whether a member has a docstring, in the class or in one from which it derives."""
    return any((inspect.getdoc(base.__dict__[member]) or "").strip() for base in thing.__mro__ if member in vars(base))


def test_all_that_is_public_has_a_docstring():
    assert [one for name in fh.__all__ for one in undocumented(name)] == []


def test_what_has_no_docstring_is_found(monkeypatch):
    monkeypatch.setattr(fh.Lattice.index, "__doc__", None)
    assert list(undocumented("Lattice")) == ["Lattice.index"]
