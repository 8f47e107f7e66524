"""The rooms of the package: each imports only from those before it, and there are no circular imports."""

import ast
from pathlib import Path

import pytest

import farhorizon

TESTS = Path(__file__).parent
PACKAGE = TESTS.parent / "src" / "farhorizon"

#: Each room imports from those above it; a single module at the root is named like a room.
ORDER = (
    "rounding",  # margins in double precision
    "errors",
    "kinds",
    "arguments",  # what a parameter means: its unit, and how a case file gives it
    "machine",
    "files",  # formats on disk, no physics
    "pictures",  # arrays to PNG
    "engine.codegen",
    "engine",  # compiled loops over addresses, no physics
    "geometry",  # where: regions, cuts, nodes
    "medium",  # the operator and its time step
    "analysis.exact",
    "analysis.references",
    "analysis.layers",
    "analysis.fracture",
    "analysis",  # what follows from the symbol
    "models",  # one file per physics
    "boundaries",  # one file per type of side
    "inputs",  # what a user adds to a medium
    "checks",  # questions about a set-up before its run
    "simulation",  # a set-up that runs
    "studies",  # several runs side by side
    "inverse",  # gradients of what is recorded
    "public",  # every public name
    "case",  # TOML to a set-up
    "",
    "papers",  # published figures
    "validation",  # exact solutions of unbounded media
    "cli",
    "__main__",  # the entry point: `farhorizon` itself, which loads public names lazily, and the command line
)
#: Names that a package's own file defines before it imports anything, so that all modules may import them.
GROUND = {("farhorizon", "__version__")}
#: What papers and validations use beside public names, because nothing public does it; rooms or modules.
BESIDE_PUBLIC = (
    "pictures",  # their drawings
    "studies.collection",  # the frame of their lists
    "studies.toughness",  # a crack that runs through an infinite plane
    "analysis.references",  # exact solutions, with which runs are compared
    "analysis.fracture.opening",  # the intensity that follows from the opening of a crack
    "analysis.exact",  # kernels of a half-infinite chain, which Ji et al. (2021) derive
    "engine.codegen.compiled",  # Numba's decorator, for the bar of that paper
)


def modules():
    """Return the path of each module by name; a package is represented by its own file."""
    found = {}
    for path in sorted(PACKAGE.rglob("*.py")):
        words = path.relative_to(PACKAGE.parent).with_suffix("").parts
        found[".".join(words[:-1] if words[-1] == "__init__" else words)] = path
    return found


def imports(source, name, known, package=False):
    """Return the modules among the known ones that a module imports anywhere: at the top, in functions, for types."""
    found = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names if alias.name.split(".")[0] == "farhorizon"}
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                above = name.split(".")[: len(name.split(".")) - node.level + package]
                base = ".".join([*above, *([base] if base else [])])
            if base.split(".")[0] == "farhorizon":
                names = {alias.name for alias in node.names if (base, alias.name) not in GROUND}
                found |= {f"{base}.{n}" if f"{base}.{n}" in known else base for n in names}
    assert found <= set(known), f"{name} imports {found - set(known)}"
    return found - {name}


def room_of(module):
    """Return the room of a module: the longest name in `ORDER` to which it belongs."""
    inner = module.removeprefix("farhorizon").lstrip(".")
    rooms = [room for room in ORDER if inner == room or (room and inner.startswith(f"{room}."))]
    assert rooms, f"{module} stands in no room"
    return max(rooms, key=len)


def circle(arrows):
    """Return modules that import each other in a circle; empty if there is none."""
    state, path = {}, []

    def visit(name):
        state[name] = "open"
        path.append(name)
        for other in sorted(arrows.get(name, ())):
            if state.get(other) == "open":
                return path[path.index(other) :]
            if other not in state and (found := visit(other)):
                return found
        state[name] = "done"
        path.pop()
        return []

    return next((found for name in sorted(arrows) if name not in state and (found := visit(name))), [])


def against_order(arrows):
    """Return the imports of a room from a later one."""
    places = {room: place for place, room in enumerate(ORDER)}
    pairs = [(one, other) for one, others in arrows.items() for other in others]
    return sorted(f"{one} imports {other}" for one, other in pairs if places[room_of(one)] < places[room_of(other)])


@pytest.fixture(scope="module")
def arrows():
    """What each module of the package imports."""
    known = modules()
    return {name: imports(path.read_text(), name, known, path.name == "__init__.py") for name, path in known.items()}


def test_rooms_import_from_those_before_them(arrows):
    assert against_order(arrows) == []


def test_no_modules_import_each_other_in_a_circle(arrows):
    assert circle(arrows) == []


def test_no_module_imports_the_face_of_its_own_room(arrows):
    """The room would be only half loaded: a circular import, though the names of the modules do not show it. The
    package itself loads its public names late, so that the last rooms may import them from it, as users do.
    """
    doors = {name for name in arrows if room_of(name) in ("papers", "validation", "cli", "__main__")}
    pairs = [(one, other) for one, others in arrows.items() if one not in doors for other in others]
    inside = [(one, other) for one, other in pairs if one.startswith(f"{other}.")]
    assert inside == []


def test_papers_and_validations_use_public_names(arrows):
    """They are written like programs of users, and so prove the interface."""
    used = {name: others for name, others in arrows.items() if room_of(name) in ("papers", "validation")}
    internal = {
        f"{name} imports {other}"
        for name, others in used.items()
        for other in others - {"farhorizon"}
        if not any(f"{other}.".startswith(f"farhorizon.{room}.") for room in (*BESIDE_PUBLIC, room_of(name), "public"))
    }
    assert internal == set()
    names = {
        alias.name
        for name in used
        for node in ast.walk(ast.parse(modules()[name].read_text()))
        if isinstance(node, ast.ImportFrom) and node.module == "farhorizon"
        for alias in node.names
    }
    assert names <= set(farhorizon.__all__)


def test_every_room_is_there_and_says_what_it_is(arrows):
    assert {room_of(name) for name in arrows} == set(ORDER)
    silent = [name for name, path in modules().items() if not ast.get_docstring(ast.parse(path.read_text()))]
    assert silent == []


def test_no_module_gives_one_name_to_two_things():
    """The second of two constants of one name would count where the first is meant, with no other sign of it."""
    twice = []
    for name, path in modules().items():
        given = []
        for node in ast.parse(path.read_text()).body:
            targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
            for target in targets if isinstance(node, ast.Assign | ast.AnnAssign) else []:
                given += [one.id for one in getattr(target, "elts", [target]) if isinstance(one, ast.Name)]
            given += [node.name] if isinstance(node, ast.FunctionDef | ast.ClassDef) else []
        twice += [f"{name}.{one}" for one in sorted({one for one in given if given.count(one) > 1} - {"_"})]
    assert twice == []


def test_tests_stand_in_rooms_of_the_same_names():
    """The exceptions are tests of the whole program, of single modules at the root, of robustness and of user
    extensions.
    """
    folders = {path.parent.relative_to(TESTS).as_posix() for path in TESTS.rglob("test_*.py")}
    assert [name for name in folders - {"robustness", "extensions"} if not (PACKAGE / name).is_dir()] == []
    apart = sorted(path.stem for path in TESTS.glob("test_*.py"))
    elsewhere = [name for name in apart if any(PACKAGE.glob(f"*/**/{name.removeprefix('test_')}.py"))]
    assert elsewhere == []


@pytest.mark.parametrize(
    "source",
    [
        "from farhorizon.simulation.run import Run",
        "from farhorizon.simulation import run",
        "import farhorizon.simulation.run",
        "from ..simulation.run import Run",
        "from ..simulation import run",
        "def late():\n    from farhorizon.simulation.run import Run",
        "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from farhorizon.simulation.run import Run",
    ],
)
def test_an_import_is_seen_however_it_is_written(source):
    known = {"farhorizon.checks.report", "farhorizon.simulation", "farhorizon.simulation.run"}
    found = imports(source, "farhorizon.checks.report", known)
    assert found == {"farhorizon.simulation.run"}
    [told] = against_order({"farhorizon.checks.report": found})
    assert told == "farhorizon.checks.report imports farhorizon.simulation.run"
    assert against_order({"farhorizon.simulation.run": {"farhorizon.checks.report"}}) == []


def test_a_circle_is_seen():
    assert circle({"a": {"b"}, "b": {"c"}, "c": {"b"}, "d": {"a"}}) == ["b", "c"]
    assert circle({"a": {"b", "c"}, "b": {"c"}, "c": set()}) == []


def test_rooms_of_rooms():
    names = ("", ".engine.engine", ".engine.codegen.vectors", ".analysis", ".cli")
    assert [room_of(f"farhorizon{name}") for name in names] == ["", "engine", "engine.codegen", "analysis", "cli"]
