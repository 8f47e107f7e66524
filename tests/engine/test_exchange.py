"""Messages between processes, with a process as its own neighbour, which amounts to periodic sides."""

import ctypes
from types import SimpleNamespace

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.engine.exchange import Link, Messages, free_of_halos
from farhorizon.engine.settings import connect
from interpreter import Interpreter

ITSELF = Link((0, 0, 0, 0), 0, 0, False, 0)


def periodic(dim=2, **more):
    """Waves that cross a periodic side and travel along layers."""
    shape = (17, 19, 21)[:dim]
    sides = {"x": fh.Periodic(), "y": fh.LatticePML(nodes=4), "z": fh.LatticePML(nodes=4)}
    u = np.zeros(shape)
    u[:3, 8:11] = np.random.default_rng(5).standard_normal(u[:3, 8:11].shape)
    lattice = fh.Lattice(1.0, [0.0] * dim, [n - 1.0 for n in shape])
    boundary = {axis: side for axis, side in sides.items() if axis in "xyz"[:dim]}
    return fh.Simulation(lattice, fh.Wave(fh.Kernel(2.0)), boundary, {"u": u}, threads=1, **more)


class Mailbox:
    """An MPI whose processes are all alike: a message to number 1 arrives as the message from number 1.

    Messages arrive in MPI_Waitall, and no sooner, once their arrival has been tested often enough.

    Parameters
    ----------
    wide : bool
        Whether handles are pointers.

    Attributes
    ----------
    link : Link
        The link of process 0.
    calls : list of str
    seen : list
        What `look` returned each time messages were waited for.
    """

    def __init__(self, wide=False):
        self.calls, self.sent, self.expected, self.seen = [], {}, {}, []
        self.look = lambda: None
        self.handle, self.requests = ctypes.c_void_p if wide else ctypes.c_int, 0
        self.communicator, self.kind = (0x7F1122334455667, 0x7F1122334455663) if wide else (0x44000001, 0x4C00010D)
        integer, pointer = ctypes.c_int, ctypes.c_void_p
        begins = ctypes.CFUNCTYPE(integer, pointer, integer, self.handle, integer, integer, self.handle, pointer)
        waits = ctypes.CFUNCTYPE(integer, integer, pointer, pointer)
        tests = ctypes.CFUNCTYPE(integer, integer, pointer, ctypes.POINTER(integer), pointer)
        self.kept = begins(self.send), begins(self.receive), waits(self.wait), tests(self.test)
        functions = tuple(ctypes.cast(function, ctypes.c_void_p).value for function in self.kept)
        self.link = Link(functions, self.communicator, self.kind, wide, 0)

    def begin(self, datatype, rank, communicator, request):
        assert (datatype, rank, communicator) == (self.kind, 1, self.communicator)
        self.requests += 1
        self.handle.from_address(request).value = self.requests

    def send(self, buffer, count, datatype, to, tag, communicator, request):
        self.begin(datatype, to, communicator, request)
        assert tag not in self.sent
        self.sent[tag] = ctypes.string_at(buffer, count)
        self.calls.append("send")
        return 0

    def receive(self, buffer, count, datatype, source, tag, communicator, request):
        self.begin(datatype, source, communicator, request)
        self.expected[tag] = buffer, count
        self.calls.append("receive")
        return 0

    def test(self, count, requests, flag, statuses):
        flag[0] = 0
        self.calls.append("test")
        return 0

    def wait(self, count, requests, statuses):
        handles = list((self.handle * count).from_address(requests))
        assert handles == list(range(handles[0], handles[0] + count)) and handles[-1] <= self.requests
        ctypes.memset(statuses, 0, 64 * count)
        self.seen.append(self.look())
        for tag in list(self.expected)[: count // 2]:  # those that were begun first
            buffer, length = self.expected.pop(tag)
            assert length == len(self.sent[tag])
            ctypes.memmove(buffer, self.sent.pop(tag), length)
        self.calls.append("wait")
        return 0


def connected(sim, mailbox=None):
    """The same simulation with messages to itself, or through a mailbox, in place of copies."""
    sides = [(axis, side) for axis in sim.engine.layout.periodic for side in (-1, 1)]
    if mailbox is None:
        connect(sim.engine, ITSELF, dict.fromkeys(sides, 0))
    else:
        connect(sim.engine, mailbox.link, dict.fromkeys(sides, 1))
    return sim


def places_of(sim, low, high):
    """Indices into a level of the nodes in a box."""
    return sim.engine.layout.box.node_indices()[tuple(map(slice, low, high))]


def waves(dim, **more):
    """Waves from noise across sides that are all periodic."""
    shape = (53, 41, 37)[:dim]
    lattice = fh.Lattice(1.0, [0.0] * dim, [n - 1.0 for n in shape])
    u = np.random.default_rng(3).standard_normal(shape)
    return fh.Simulation(lattice, fh.Wave(fh.Kernel(2.0)), fh.Periodic(), {"u": u}, threads=1, **more)


@pytest.mark.parametrize(("dim", "real"), [(2, "float64"), (2, "float32"), (3, "float64")])
def test_rows_that_need_no_halo_are_swept_while_messages_travel(dim, real):
    """Messages along the last axis come first. When the last messages of a step are waited for, the rows that need no
    halo have their new values, and the others do not.
    """
    mailbox = Mailbox()
    plain, exchanged = waves(dim, dtype=real), connected(waves(dim, dtype=real), mailbox)
    mailbox.look = exchanged.engine.levels.copy
    (low, high), nodes = exchanged.engine.tables.free.tolist(), exchanged.engine.layout.box.nodes
    assert (low, high) == (([0, 2], [1, 51]) if dim == 2 else ([2, 2], [51, 39]))
    free, nodes_of_box = places_of(exchanged, (*low, 0), (*high, nodes[2])), places_of(exchanged, (0, 0, 0), nodes)
    late = np.setdiff1d(nodes_of_box, free)
    for sim in (plain, exchanged):
        sim.step(2)  # from rest the first step returns to the level before it
    for _ in range(3):
        mailbox.seen.clear()
        plain.step(1)
        exchanged.step(1)
        np.testing.assert_array_equal(exchanged.fields["u"], plain.fields["u"])
        new = plain.engine.current
        # the share of these rows that are swept at each wait of this step, one wait per axis
        done = [max((level[free] == new[free]).mean() for level in levels) for levels in mailbox.seen]
        assert len(done) == dim and done[0] < 0.05 and done[-1] == 1 and (dim == 2 or 0.3 < done[1] < 0.7), done
        assert max((level[late] == new[late]).mean() for level in mailbox.seen[-1]) < 0.05


@pytest.mark.parametrize("wide", [False, True], ids=["numbers", "pointers"])
def test_calls_of_mpi(wide):
    """Receives are posted before anything is sent, MPI is polled as parts of the box are swept, and no message is left
    over.
    """
    mailbox = Mailbox(wide)
    sim = connected(waves(2), mailbox)
    mailbox.calls.clear()
    sim.engine.advance(1)
    calls = "".join(call[0] for call in mailbox.calls)
    last, second, rest = calls.split("w")
    assert last == "rrss" and second.rstrip("t") == "rrss" and second.count("t") >= 2, calls
    assert not rest and not mailbox.sent and not mailbox.expected


def breaking():
    """A bar that tears across a periodic side."""
    lattice = fh.Lattice(1.0, (0.0, 0.0), (95.0, 40.0))
    solid = fh.Elastic(fh.Kernel(2.0), 1.0, critical_stretch=0.005, nonlinear=True)
    pull = fh.BodyForce([0.0, "0.02*(exp(-(y - 26)**2/4) - exp(-(y - 14)**2/4))*(1 - 0.5*cos(x/15))"], "1 - exp(-t)")
    return fh.Simulation(lattice, solid, {"x": fh.Periodic(), "y": fh.Free()}, loads=[pull], threads=1)


def dissolving(at=46.0, **model):
    """Metal beside a periodic side."""
    lattice = fh.Lattice(1.0, (0.0, 0.0), (95.0, 40.0))
    disc = fh.Specimen(fh.Disc(9.0, (at, 17.0)))
    sides = {"x": fh.Periodic(), "y": fh.LatticePML(nodes=4)}
    corrodes = fh.Corrosion(fh.Kernel(2.0), saturation=0.8, **model)
    return fh.Simulation(lattice, corrodes, sides, specimens=[disc], threads=1)


def dissolving_across():
    """Metal across the periodic side, where nothing is swept ahead, with an integrator of several stages."""
    return dissolving(2.0, integrator=fh.RungeKuttaChebyshev(3))


@pytest.mark.parametrize("make", [breaking, dissolving, dissolving_across], ids=lambda make: make.__name__)
def test_parts_with_a_law_of_their_own_are_swept_whole(make):
    """Fields agree bitwise, and some of the nodes are swept while messages travel."""
    mailbox = Mailbox()
    plain, exchanged = make(), make()
    connected(exchanged, mailbox)
    if make is not breaking:
        exchanged.parts.phases.start()
    mailbox.look = exchanged.engine.levels.copy
    nodes, ahead = places_of(exchanged, (0, 0, 0), exchanged.engine.layout.box.nodes).ravel(), 0.0
    for _ in range(60):
        mailbox.seen.clear()
        old = plain.engine.current.copy()
        plain.step(1)
        exchanged.step(1)
        new = plain.engine.current
        moved = nodes[new[nodes] != old[nodes]]
        same = [(level[moved] == new[moved]).sum() for level in mailbox.seen[-1]]
        ahead = max(ahead, max(same) / max(len(moved), 1))
    for name, values in plain.fields.items():
        np.testing.assert_array_equal(exchanged.fields[name], values)
    if make is breaking:
        assert plain.broken_bonds == exchanged.broken_bonds > 100
    assert (ahead > 0.3) == (make is not dissolving_across)


def test_threads_share_what_is_swept_ahead():
    """One thread handles the messages while the others sweep."""
    u = np.random.default_rng(4).standard_normal((331, 301))
    lattice = fh.Lattice(1.0, (0.0, 0.0), (330.0, 300.0))
    sides = {"x": fh.Periodic(), "y": fh.LatticePML(nodes=4)}
    given = lattice, fh.Wave(fh.Kernel(2.0)), sides, {"u": u * (np.indices(u.shape)[1] % 300 > 20)}
    mailbox = Mailbox()
    plain, exchanged = fh.Simulation(*given, threads=1), connected(fh.Simulation(*given, threads=2), mailbox)
    assert exchanged.engine.threads == 2 and exchanged.engine.tables.free.any()
    for sim in (plain, exchanged):
        sim.step(25)
    np.testing.assert_array_equal(exchanged.fields["u"], plain.fields["u"])
    assert mailbox.calls.count("wait") == 2 * 25  # those of the field, and of the contributions of the layers


def test_boxes_without_a_row_to_spare():
    """Where all rows need a halo none is swept ahead; a halo along the last axis does not count."""

    def free(nodes, *sides):
        layout = SimpleNamespace(box=SimpleNamespace(nodes=nodes), reach=(2, 2, 2))
        return free_of_halos(layout, dict.fromkeys(sides, 3) | {(2, -1): -1}).tolist()

    assert free((9, 30, 30), (1, -1)) == [[0, 2], [9, 30]]
    assert free((9, 30, 30), (1, -1), (1, 1), (0, 1)) == [[0, 2], [7, 28]]
    assert free((9, 30, 4), (2, 1)) == [[0, 0], [9, 30]]
    assert free((9, 4, 30), (1, -1), (1, 1)) == [[0, 0], [0, 0]]


@pytest.mark.parametrize("mailbox", [None, Mailbox()], ids=["itself", "mailbox"])
@pytest.mark.parametrize("more", [{}, {"dtype": "float32"}], ids=str)
def test_messages_to_itself_are_periodic_sides(more, mailbox):
    """Fields agree bitwise, and so do energies."""
    plain, exchanged = periodic(**more), connected(periodic(**more), mailbox)
    for sim in (plain, exchanged):
        sim.step(60)
    np.testing.assert_array_equal(exchanged.fields["u"], plain.fields["u"])
    assert exchanged.energy() == plain.energy() and np.abs(plain.fields["u"]).max() > 1e-3


@pytest.mark.parametrize("model", [{}, {"integrator": fh.RungeKuttaChebyshev(3)}], ids=str)
def test_metal_dissolves_beyond_a_side_as_before_it(model):
    """Metal across a periodic side: nodes of the halo dissolve according to the values that are sent, as with periodic
    copies.
    """

    def corrosion():
        lattice = fh.Lattice(1.0, (0.0, 0.0), (16.0, 40.0))
        disc = fh.Specimen(fh.Disc(5.0, (0.0, 17.0)) | fh.Disc(5.0, (17.0, 17.0)))
        sides = {"x": fh.Periodic(), "y": fh.LatticePML(nodes=4)}
        corrodes = fh.Corrosion(fh.Kernel(2.0), saturation=0.8, **model)
        return fh.Simulation(lattice, corrodes, sides, specimens=[disc], threads=1)

    plain, exchanged = corrosion(), connected(corrosion())
    exchanged.parts.phases.start()
    assert len(exchanged.engine.tables.phases.halo) > 10
    for sim in (plain, exchanged):
        sim.step(150)
        assert (sim.engine.tables.material.coefficient[sim.engine.tables.phases.halo[:, 0]] > 0).all()
    for name, values in plain.fields.items():
        np.testing.assert_array_equal(exchanged.fields[name], values)
    assert np.nanmax(plain.fields["dissolved"]) > 0 and plain.fields["solid"].sum() < 40


@pytest.mark.slow
def test_in_space_and_with_states():
    """The slots of layers and the states of two passes are exchanged, too."""
    plain, exchanged = periodic(3), periodic(3)
    model = fh.Elastic(fh.Kernel(2.0), young=1.0, poisson=0.3, material="state-based")
    lattice = fh.Lattice(1.0, (0, 0, 0), (9, 10, 11))
    start = {"u": ["exp(-x)", 0.0, "exp(-y)"]}
    pair = [fh.Simulation(lattice, model, fh.Periodic(), start, threads=1) for _ in range(2)]
    boxes = Mailbox(), Mailbox()
    exchanged, pair[1] = connected(exchanged, boxes[0]), connected(pair[1], boxes[1])
    for first, second in ((plain, exchanged), pair):
        first.step(40)
        second.step(40)
        np.testing.assert_array_equal(second.fields["u"], first.fields["u"])


def test_the_interpreter_does_the_same():
    plain, interpreted = connected(periodic()), connected(periodic())
    interpreted.engine.loop = Interpreter(interpreted.engine)
    for sim in (plain, interpreted):
        sim.step(12)
    np.testing.assert_allclose(interpreted.fields["u"], plain.fields["u"], rtol=0, atol=1e-12)


def test_whom_messages_go_to():
    """The values that would fill my halo if I were periodic fill that of my neighbour on the other side."""
    layout = periodic().engine.layout
    across = {(1, side): layout.across(1, side) for side in (-1, 1)}
    messages = Messages.between(Link((0, 0, 0, 0), 0, 0, False, 5), {(1, -1): 4, (1, 1): -1}, across)
    (down, to_nobody) = messages.rows
    assert down[:2] == (-1, 4) and to_nobody[:2] == (4, -1)
    box = layout.box
    assert set(box.coordinates(to_nobody[2])[:, 1]) == {0, 1}  # my first nodes, of a reach of two
    assert set(box.coordinates(down[3])[:, 1]) == {-2, -1}  # my halo before them
    assert messages.volume == len(to_nobody[2]) == 2 * (box.nodes[2] + 2 * 2)  # with the halo of the last axis
