"""The examples in the docstrings of all public names: there is one each, and it gives what it says."""

import doctest
import inspect

import pytest

import farhorizon as fh


@pytest.mark.parametrize("name", sorted(fh.__all__))
def test_example(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    text = inspect.getdoc(getattr(fh, name))
    found = doctest.DocTestParser().get_doctest(text, {}, name, None, None)
    assert any(example.source.startswith("import farhorizon as fh") for example in found.examples)
    said = []
    assert doctest.DocTestRunner().run(found, out=said.append).failed == 0, "".join(said)
