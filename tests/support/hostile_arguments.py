"""Public functions, constructors and methods with valid arguments, and hostile values for each argument."""

from __future__ import annotations

import inspect
import signal
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields, is_dataclass, replace
from decimal import Decimal
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

import crosscheck
import mjcf
import newton_euler as ne
import urdf
from crosscheck.library import load
from newton_euler import Body, Mechanism, Revolute, Scene
from newton_euler.model.scene import OUTPUTS

LONGEST_CALL = 60.0  # s, of a call with hostile arguments, on a machine with much other work
LONGEST_MESSAGE = 600  # characters


class Text(str):
    """A subclass of text."""


class Whole(int):
    """A subclass of whole numbers."""


class Silent:
    """An object that neither shows nor compares itself."""

    def __repr__(self) -> str:
        raise RuntimeError("not shown")

    def __eq__(self, other: object) -> bool:
        raise RuntimeError("not compared")

    __hash__ = object.__hash__


def _recursive() -> list[Any]:
    """Return a list that holds itself."""
    found: list[Any] = [1.0]
    found.append(found)
    return found


def _deep() -> list[Any]:
    """Return lists inside each other, deeper than Python recurses."""
    found: list[Any] = []
    for _ in range(20_000):
        found = [found]
    return found


NUMBERS: dict[str, Callable[[], Any]] = {
    "nan": lambda: np.nan,
    "inf": lambda: np.inf,
    "-inf": lambda: -np.inf,
    "-1": lambda: -1,
    "-1.5": lambda: -1.5,
    "0": lambda: 0,
    "1e308": lambda: 1e308,
    "1e-320": lambda: 1e-320,
    "2**63": lambda: 2**63,
    "10**400": lambda: 10**400,
    "4301 digits": lambda: -(10**4301),
    "True": lambda: True,
    "1j": lambda: 1j,
    "np.nan": lambda: np.float64(np.nan),
    "np.int64": lambda: np.int64(-7),
    "np.float16": lambda: np.float16(0.1),
    "np.True_": lambda: np.True_,
    "Decimal": lambda: Decimal("0.1"),
    "Fraction": lambda: Fraction(1, 3),
    "np.timedelta64": lambda: np.timedelta64(1, "s"),
    "np.datetime64": lambda: np.datetime64("2020-01-01"),
    "Whole": lambda: Whole(3),
}

TEXTS: dict[str, Callable[[], Any]] = {
    "empty text": lambda: "",
    "text": lambda: "nix",
    "control characters": lambda: "a\nb\x1b[31m\x00\u2028\r",
    "surrogate": lambda: "\ud800",
    "long text": lambda: "x" * 100_000,
    "Text": lambda: Text("nix"),
    "bytes": lambda: b"x",
    "bytearray": lambda: bytearray(b"x"),
    "missing file": lambda: Path("nowhere/missing.xml"),
    "missing text file": lambda: "nowhere/missing.urdf",
    "folder": lambda: Path("."),
    "folder as text": lambda: ".",
    "device": lambda: "/dev/null",
    "below a device": lambda: "/dev/null/x.xml",
    "many folders": lambda: "x/" * 3000 + "y.yaml",
}

CONTAINERS: dict[str, Callable[[], Any]] = {
    "[]": list,
    "()": tuple,
    "{}": dict,
    "set": lambda: {1.0},
    "ragged": lambda: [1.0, [2.0, 3.0]],
    "ragged array": lambda: [[1.0], [2.0, 3.0]],
    "list of None": lambda: [None],
    "list of text": lambda: ["nix"],
    "list of numbers": lambda: [0.1, 0.2],
    "tuple of pairs": lambda: (("nix", 0), ("nix", "x")),
    "pair": lambda: ("nix", 10**30),
    "recursive": _recursive,
    "deep": _deep,
    "generator": lambda: (each for each in (1.0, 2.0)),
    "range": lambda: range(3),
    "huge range": lambda: range(10**12),
    "dictionary of numbers": lambda: {1: 2.0, None: 3.0},
    "dictionary of text": lambda: {"nix": "nix"},
    "dictionary of pairs": lambda: {("nix", 0): 1.0, ("nix", -(10**30)): None},
    "empty array": lambda: np.zeros(0),
    "array": lambda: np.ones(7),
    "array of one": lambda: np.array(1.0),
    "array of 4 dimensions": lambda: np.ones((2, 1, 3, 4)),
    "array of nan": lambda: np.full((3, 3), np.nan),
    "array of objects": lambda: np.array([None, "x", object()], dtype=object),
    "array of text": lambda: np.array(["nix", "a\nb"]),
    "complex array": lambda: np.array([1j, 2.0]),
    "masked array": lambda: np.ma.masked_array([1.0, 2.0], [True, False]),
    "structured array": lambda: np.zeros(2, dtype=[("a", float), ("b", int)]),
}

OBJECTS: dict[str, Callable[[], Any]] = {
    "None": lambda: None,
    "object": object,
    "class": lambda: float,
    "Scene class": lambda: Scene,
    "function": lambda: lambda *_: None,
    "module": lambda: np,
    "Ellipsis": lambda: ...,
    "Silent": Silent,
}

VALUES = NUMBERS | TEXTS | CONTAINERS | OBJECTS
"""Functions that make hostile values, by their names in messages."""

LONG = (
    *("mjcf.read", "urdf.read", "crosscheck.check", "crosscheck.sweep", "crosscheck.tune"),
    *("Verdict.save", "Sweep.check", "Sweep.save"),
)
"""Names of targets that take seconds: other processes, files and pictures."""

FEW = (
    *("nan", "-1.5", "1e308", "10**400", "4301 digits", "1j", "Fraction", "control characters", "surrogate"),
    *("long text", "bytes", "folder", "below a device", "()", "ragged", "recursive", "deep", "huge range"),
    *(
        "generator",
        "dictionary of pairs",
        "array of one",
        "array of nan",
        "array of objects",
        "None",
        "Silent",
    ),
)
"""One value or two of each kind."""


@dataclass(frozen=True)
class Target:
    """A public function, constructor or method.

    Attributes:
        name: in messages.
        call: the callable.
        arguments: valid ones, by name.
        placed: names of arguments that have no keywords.
    """

    name: str
    call: Callable[..., Any]
    arguments: Mapping[str, Any]
    placed: tuple[str, ...] = ()

    @property
    def is_long(self) -> bool:
        """True for calls that take seconds with valid arguments."""
        return self.name in LONG

    def with_value(self, argument: str, value: Any) -> Callable[[], Any]:
        """Return the call with another value of an argument."""
        given = {**self.arguments, argument: value}
        placed = [given.pop(name) for name in self.placed]
        return lambda: self.call(*placed, **given)

    def cases(self, values: Collection[str]) -> Iterator[tuple[str, Callable[[], Any]]]:
        """Make all calls with one hostile value in place of an argument, or in it if it is a container."""
        for argument, valid in self.arguments.items():
            for name, make in VALUES.items():
                if name not in values or (callable(valid) and callable(make())):
                    continue  # errors of functions that are called are those of whoever wrote them
                yield f"{self.name}({argument}={name})", self.with_value(argument, make())
                for place, embedded in _embedded(valid, make):
                    yield f"{self.name}({argument}={place} {name})", self.with_value(argument, embedded)


def _embedded(valid: Any, make: Callable[[], Any]) -> Iterator[tuple[str, Any]]:
    """Put a hostile value into containers that are like a valid one."""
    if isinstance(valid, Mapping):
        for key in list(valid)[:1]:
            yield "dictionary with", {**valid, key: make()}
            yield "dictionary with a list of", {**valid, key: [make()]}
        if not isinstance(make(), list | dict | set | bytearray | np.ndarray):
            yield "dictionary by", {**valid, make(): next(iter(valid.values()), 1.0)}
    elif isinstance(valid, Sequence) and not isinstance(valid, str):
        yield "list of", [make()]
        yield "longer list with", [*valid, make()]
        yield "tuple with", (make(), *valid[1:])


@contextmanager
def time_limit(seconds: float) -> Iterator[None]:
    """Raise `AssertionError` in a block that takes longer."""

    def stop(*_: object) -> None:
        raise AssertionError(f"took longer than {seconds} s")

    before = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def fault_of(call: Callable[[], Any]) -> str:
    """Return what is wrong with the answer to hostile arguments; empty if nothing is."""
    try:
        with time_limit(LONGEST_CALL):
            call()
    except (ne.NewtonEulerError, crosscheck.CrosscheckError) as error:
        message = str(error)
        if len(message.splitlines()) != 1 or not message.isprintable():
            return f"{type(error).__name__} of several lines: {message!r:.300}"
        if len(message) > LONGEST_MESSAGE:
            return f"{type(error).__name__} of {len(message)} characters: {message:.300}"
        return ""
    except Exception as error:
        return f"{type(error).__name__}: {error!s:.200}"
    return ""


# Valid arguments

ARM = Body("arm", 1.0, [0.5, 0.0, 0.0], np.diag([0.01, 0.1, 0.1]).tolist())
PIVOT = Revolute("pivot", "ground", "arm", [0.0, 0.0, 0.0], axis=[0.0, 1.0, 0.0], actuated=True)
LAW = ne.PD("pivot", 10.0, 1.0, 0.0)
SWING = Scene("swing", Mechanism([Body.ground(), ARM], [PIVOT]), 0.05, 0.01, [0.0, 0.0, -9.81], [LAW])
FOUR_BAR = load("four_bar")
FACES = [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]
CORNERS = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
SINE = ne.Sine(0.1, 2.0)


def functions(folder: Path) -> list[Target]:
    """Return the public functions; files are written into a folder."""
    run = ne.simulate(SWING)
    state = ne.initial_state(SWING)
    axis, tip = ne.Axis("arm", [0.0, 0.0, 1.0]), ne.Point("arm", [0.1, 0.0, 0.0])
    times = np.linspace(0.0, 0.05, 6)
    (folder / "run.csv").write_text(
        "\n".join(["time,coordinate.pivot", *(f"{t},{0.1 * t}" for t in times)]), encoding="utf-8"
    )
    (folder / "base.csv").write_text(
        "\n".join(["time,roll", *(f"{t / 10},{0.01 * t}" for t in range(10))]), encoding="utf-8"
    )
    mjcf.write(SWING, folder / "swing.xml")
    urdf.write(SWING, folder / "swing.urdf")
    measured = ne.Measurements(run.time, {"coordinate.pivot": run.joint("pivot").coordinates[:, 0]})
    steps = {"rtol": 1e-8, "atol": 1e-10, "most_steps": 1000}
    chosen: dict[str, Any] = {"formulation": "relative", "stabilization": "projection", "alpha": None}
    read = {"duration": 0.05, "output_period": 0.01, "redundancy_tolerance": 1e-4, "verified": True}
    read |= {"excitation": False}
    vary = {"arm.mass": "normal(1, 0.1)"}
    sampled = {"runs": 2, "keep": ["peak:reaction_force"], "sampling": "random", "seed": 0, "output": None}
    placed = {"threads": 1, "executor": None, "cluster": None, "progress": print}
    pivot, at_pivot = {"pivot": 0.1}, ["pivot"]
    given: list[tuple[Callable[..., Any], dict[str, Any]]] = [
        (ne.assemble, {"guess": state}),
        (ne.assembly_branches, {"coordinates": pivot, "axis": None, "towards": None, "measure": ()}),
        (ne.assembly_branches, {"start": state, "coordinates": pivot}),
        (ne.compile_scene, {**chosen, "parameters": ["arm.mass"]}),
        (ne.equilibrium, {"state": state}),
        (ne.identify, {"parameters": ["arm.mass"], "measurements": [measured], "formulation": None, **steps}),
        (ne.initial_state, {}),
        (
            ne.inverse_dynamics,
            {"states": run, "accelerations": pivot, "actuators": at_pivot, "rates": pivot, "time": 0.0},
        ),
        (
            ne.linearize,
            {"state": state, "coordinates": at_pivot, "inputs": at_pivot, "outputs": at_pivot},
        ),
        (ne.linearize, {"closed_loop": True, "time": 0.0}),
        (ne.load_envelope, {"runs": {"run": run}}),
        (ne.load_envelope, {"runs": run}),
        (ne.lqr, {"Q": [1.0, 1.0], "R": 1.0, "state": state, "coordinates": at_pivot}),
        (ne.lqr, {"Q": [1.0, 1.0], "R": 1.0, "actuators": at_pivot, "targets": pivot}),
        (ne.on_moving_base, {"motions": {"heave": SINE}, "hull": ARM, "point": [0.0, 0.0, 0.0]}),
        (ne.on_moving_base, {"motions": {"heave": SINE}, "world": "world", "joint": "base"}),
        (ne.rest_case, {}),
        (ne.sensitivities, {"parameters": ["arm.mass"], "formulation": None, **steps, "rest": 0.0}),
        (ne.sensitivities, {"parameters": {"arm.mass": 1.0}}),
        (ne.simulate, {**chosen, "integrator": "DOP853", **steps, "rest": 0.0}),
        (ne.simulate, {"integrator": "RK4", "step": 0.01}),
        (ne.simulate_batch, {**chosen, "states": [state], "threads": 1, "integrator": "DOP853", **steps}),
        (ne.simulate_batch, {"parameters": {"arm.mass": [1.0]}}),
        (ne.singular_poses, {"coordinates": at_pivot, "count": 5, "axis": axis}),
        (ne.solve_poses, {"coordinates": pivot, "measure": (), "start": state}),
        (ne.solve_poses, {"axis": axis, "towards": [0.0, 0.0, 1.0]}),
        (ne.statics, {"states": state, "actuators": at_pivot}),
        (ne.start, {"pivot": (0.1, 0.0)}),
        (ne.with_parameters, {"values": {"arm.mass": 1.0}}),
        (ne.workspace, {"grid": {"pivot": [0.0, 0.1]}, "axis": axis, "start": state, "point": tip}),
        (mjcf.simulate, {"timestep": 0.001, "integrator": "RK4", "solref": [0.002, 1.0]}),
        (mjcf.to_xml, {}),
        (mjcf.write, {"path": folder / "written.xml"}),
        (urdf.simulate, {"integrator": "RK4", "step": 0.01}),
        (urdf.simulate, {"stabilization": "projection", "alpha": None}),
        (urdf.to_loops, {"keep_bodies": False}),
        (urdf.to_urdf, {"keep_bodies": False}),
        (urdf.write, {"path": folder / "written.urdf"}),
        (crosscheck.sweep, {"vary": vary, **sampled, **placed, "integrator": "RK4", "step": 0.01}),
    ]
    turbulence = {"mean": 10.0, "deviation": 1.5, "length": 11.0, "seed": 1}
    turbulence |= {"lowest": 0.01, "highest": 10.0, "count": 4}
    found = [_target(call, {"scene": SWING, **arguments}) for call, arguments in given]
    files = [
        (ne.base_motion_from_csv, {"path": folder / "base.csv"}),
        (ne.measurements_from_csv, {"path": folder / "run.csv"}),
        (ne.wind_gust, {"mean": 10.0, "gust": 5.0, "period": 10.5}),
        *((call, turbulence) for call in (ne.wind_turbulence, ne.vertical_turbulence)),
        (mjcf.read, {"model": folder / "swing.xml", "key": None, "root": None, **read}),
        (
            urdf.read,
            {"model": folder / "swing.urdf", "loops": folder / "swing.loops.yaml", "base": "fixed"}
            | {"gravity": [0.0, 0.0, -9.81], "q": None, "ignore": None, **read},
        ),
        (crosscheck.check, {"model": SWING, "engines": ["newton_euler"], "advice": False, "progress": print}),
        (
            crosscheck.check,
            {"model": str(folder / "swing.xml"), "engines": ["newton_euler"], "duration": 0.05}
            | {"output_period": 0.01, "excitation": "off", "key": "qpos0"},
        ),
        (
            crosscheck.tune,
            {"model": str(folder / "swing.xml"), "error": 0.5, "progress": print, "duration": 0.05}
            | {"output_period": 0.01, "excitation": "off", "key": "qpos0"},
        ),
        (load, {"name": "chain", "N": 2}),
    ]
    return found + [_target(call, arguments) for call, arguments in files]


def _target(call: Callable[..., Any], arguments: dict[str, Any]) -> Target:
    package = call.__module__.partition(".")[0]
    kinds = inspect.signature(call).parameters
    placed = tuple(
        name for name in arguments if name in kinds and kinds[name].kind is kinds[name].POSITIONAL_ONLY
    )
    return Target(f"{package}.{call.__name__}", call, arguments, placed)


def instances() -> list[Any]:
    """Return an instance of each public class that users construct."""
    joint = ("j", "ground", "arm", [0.0, 0.0, 0.0])
    x, y, z = np.eye(3).tolist()
    return [
        SWING,
        SWING.mechanism,
        ne.initial_state(SWING),
        ARM,
        ne.Axis("arm", z),
        ne.Point("arm", z),
        ne.Box([0.1, 0.2, 0.3], z),
        ne.Sphere(z, 0.1),
        ne.Cylinder(x, y, 0.1),
        ne.Capsule(x, y, 0.1),
        ne.Mesh(CORNERS, FACES, (0.5, 0.5, 0.5, 1.0)),
        ne.Fixed(*joint),
        ne.Revolute(*joint, axis=y),
        ne.Prismatic(*joint, axis=y),
        ne.Translational(*joint, axis=y),
        ne.Cylindrical(*joint, axis=y),
        ne.Screw(*joint, axis=y, pitch=0.1),
        ne.Planar(*joint, axis=y),
        ne.PointOnLine(*joint, axis=y),
        ne.Universal(*joint, axis_on_first=x, axis_on_second=y),
        ne.Spherical(*joint),
        ne.Rod(*joint, point_on_second=z),
        ne.Free(*joint),
        ne.Compound(*joint, slides=[x], hinges=[y]),
        ne.ParallelHinges(*joint, axis=y, offset=x),
        ne.Gear("g", "a", "b", 2.0),
        ne.LinearCoupling("c", (("a", 0, 1.0), ("b", 0, 2.0))),
        ne.PolynomialCoupling("c", "a", "b", (0.0, 1.0)),
        LAW,
        ne.ComputedTorque("pivot", 10.0, 1.0, 0.0),
        ne.StateFeedback("a", {"a": (1.0, 0.1), "b": (1.0, 0.1)}, targets={"b": 0.0}),
        ne.Digital(LAW, 0.01),
        ne.Sampled("pivot", lambda *_: 0.0, 0.01),
        ne.JointSpring("pivot", 1.0),
        ne.JointFriction("pivot", 1.0),
        ne.JointStop("pivot", "low", 0.0, 1.0),
        ne.ElasticGear("screw", "a", "b", 0.1, 1.0),
        ne.BallSpring("pivot", 1.0),
        ne.PointSpring("s", "ground", "arm", x, y, stiffness=1.0, rest_length=0.1),
        ne.Wrench("w", "arm", x, y, z),
        ne.WindLoad("w", "arm", x, first_side=x, second_side=y, direction=z, speed=1.0),
        ne.Armature("pivot", 1.0),
        ne.BallArmature("pivot", 1.0),
        ne.PrescribedMotion("pivot", SINE),
        ne.Polynomial((1.0, 2.0)),
        SINE,
        ne.Sum((SINE, SINE)),
        ne.Spline(np.arange(8.0), np.arange(8.0)),
        ne.Steps([0.0, 1.0], [0.0, 1.0]),
        ne.Measurements([0.0, 1.0], {"coordinate.pivot": [0.0, 0.1]}, {"coordinate.pivot": 0.1}),
    ]


def constructors() -> list[Target]:
    """Return the constructors of public classes, with the values of an instance."""
    found = []
    for thing in instances():
        kind = type(thing)
        names = [each.name for each in fields(thing) if each.init] if is_dataclass(thing) else []
        names = names or ["bodies", "joints", "couplings"]
        found.append(Target(kind.__name__, kind, {name: getattr(thing, name) for name in names}))
    return found


def solid_body(name: Any, solid: Any, **given: Any) -> Body:
    """Call `Body.solid` with one solid."""
    return Body.solid(name, solid, **given)


def methods(folder: Path) -> list[Target]:
    """Return the methods of public classes; files are written into a folder."""
    scene = replace(SWING, outputs=frozenset(OUTPUTS))
    run, batch = ne.simulate(scene), ne.simulate_batch(scene, parameters={"arm.mass": [1.0, 2.0]})
    poses = ne.solve_poses(SWING, {"pivot": [0.1, 0.2]})
    verdict = crosscheck.check(SWING, ["newton_euler"])
    sweep = crosscheck.sweep(SWING, {"arm.mass": "normal(1, 0.1)"}, 2, "peak:reaction_force")
    mechanism, box = SWING.mechanism, ne.Box([0.1, 0.2, 0.3], [0.0, 0.0, 0.0])
    steps = {"integrator": "DOP853", "rtol": 1e-8, "atol": 1e-10, "most_steps": 1000, "rest": 0.0}
    given: list[tuple[Callable[..., Any], dict[str, Any]]] = [
        (run.joint, {"name": "pivot"}),
        (run.first, {"outputs": 2}),
        (run.state, {"output": 0}),
        (run.save, {"path": folder / "run.npz"}),
        (batch.stacked, {"name": "position"}),
        (batch.joint, {"name": "pivot"}),
        (ne.compile_scene(SWING).simulate, steps),
        (ne.sensitivities(SWING, ["arm.mass"]).joint, {"name": "pivot"}),
        (ne.load_envelope(scene, run).of, {"element": "pivot", "quantity": "force"}),
        (poses.state, {"number": 0}),
        (poses.jacobian, {"of": ["pivot"], "by": ["pivot"]}),
        (poses.independence, {"of": ["pivot"]}),
        (ne.State.initial, {"mechanism": mechanism}),
        (mechanism.body, {"name": "arm"}),
        (mechanism.joint, {"name": "pivot"}),
        (mechanism.body_index, {"name": "arm"}),
        (mechanism.joint_index, {"name": "pivot"}),
        (mechanism.is_slide, {"joint": "pivot", "coordinate": 0}),
        (mechanism.coordinate, {"name": "pivot"}),
        (mechanism.coordinate_name, {"key": ("pivot", 0)}),
        (mechanism.joint_equations, {"name": "pivot"}),
        (Body.ground, {"name": "ground", "shapes": (box,), "meshes": ()}),
        (solid_body, {"name": "b", "solid": box, "mass": 1.0}),
        (solid_body, {"name": "b", "solid": box, "density": 1.0}),
        (box.inertia, {"density": 1.0}),
        (verdict.assert_agrees, {"allow_reduced": False}),
        (verdict.save, {"folder": folder / "verdict"}),
        (crosscheck.Outcome.AGREE.exit_status, {"allow_reduced": False}),
        (crosscheck.Outcome.AGREE.passes, {"allow_reduced": False}),
        (sweep.check, {"runs": 1, "engines": ["newton_euler"], "progress": print}),
        (sweep.save, {"folder": folder / "sweep"}),
    ]
    return [Target(call.__qualname__, call, arguments) for call, arguments in given]
