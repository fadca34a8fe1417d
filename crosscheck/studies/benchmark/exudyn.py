"""Batches by Exudyn, as its users make them: `exudyn.processing.ParameterVariation` over start states.

A process translates the scene once, into rigid bodies with Euler parameters and joints between them or into
a kinematic tree whose loops joints close; a run sets initial coordinates and solves. No Python is called in a
step: control laws are springs, and sensors keep coordinates at outputs. Redundant constraint rows are left
out: Exudyn's solver that stands them, with full pivoting, is slower. Exudyn is loaded without range checks.

J. Gerstmayr, Exudyn - a C++-based Python package for flexible multibody systems, Multibody System Dynamics
60, 2024.
"""

from __future__ import annotations

import pickle
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import redirect_stdout
from dataclasses import replace
from functools import lru_cache, partial
from io import StringIO
from itertools import product
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np

from crosscheck.errors import CrosscheckError
from crosscheck.studies.benchmark.ladders import Ladder, Options, Poses, by_step
from newton_euler.equations.redundancy import mobility
from newton_euler.equations.relative import Relative
from newton_euler.model.control import PD
from newton_euler.model.euler_parameters import matrix_l, rotation
from newton_euler.model.forces import JointSpring
from newton_euler.model.joint import Joint, Pose, perpendicular_pair
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.scalars import Array

MOST = 10_000
"""Steps from one output to the next."""

IMPLICIT = ("GeneralizedAlpha",)
"""Solvers of other scenes: of index 3, with Exudyn's own spectral radius of 0.9. On the tracker radii of 0.5
and 0.7 are less exact, and those of 0.95 and 1 and `TrapezoidalIndex2` no cheaper; this is half as exact on
the Stewart platform and does not pass the singular configurations of the four-bar."""

EXPLICIT = ("RK44", "RK67")
"""Solvers of open trees, with fixed steps: those of DOPRI5's error control do not end at outputs. On a chain
of 20 rods implicit ones take ten times as long or more."""


class Iteration(NamedTuple):
    """Newton's iteration of implicit solvers: relative tolerance, and the solver of its linear equations."""

    modified: bool
    rtol: float
    linear: str


ITERATIONS = {"bodies": Iteration(True, 1e-7, "EigenSparse"), "tree": Iteration(False, 1e-8, "EigenDense")}
"""The quickest on the tracker that do not add to the error. On its bodies full iterations take 1.6 times as
long, on its tree 0.75 times as long as modified ones."""

ROWS = {
    "fixed": (1, 1, 1, 1, 1, 1),
    "revolute": (1, 1, 1, 1, 1, 0),
    "prismatic": (1, 1, 0, 1, 1, 1),
    "translational": (1, 1, 0, 1, 1, 1),
    "cylindrical": (1, 1, 0, 1, 1, 0),
    "planar": (0, 0, 1, 1, 1, 0),
    "universal": (1, 1, 1, 0, 0, 1),
    "spherical": (1, 1, 1, 0, 0, 0),
    "point_on_line": (1, 1, 0, 0, 0, 0),
    "free": (0, 0, 0, 0, 0, 0),
}
"""Constrained translations and rotations of Exudyn's generic joint in the axes of `_axes`, by joint kind."""

WORLD = Pose(np.zeros(3), np.eye(3))

Run = Callable[[], Array]

LeftOut = Mapping[str, Sequence[int]]
"""Numbers of rows of joints, as of `ROWS`, by the names of the joints."""


def library() -> Any:
    """Import Exudyn; raises `CrosscheckError` where it is not installed."""
    vars(sys)["exudynFast"] = True  # without range checks
    try:
        with redirect_stdout(StringIO()):  # it announces that
            import exudyn
    except ImportError as error:
        raise CrosscheckError("exudyn is not installed: pip install 'crosscheck[exudyn]'") from error
    exudyn.config.printToConsole = False
    return exudyn


def ladders(interval: float, translated: Mapping[str, LeftOut]) -> Iterator[Ladder]:
    """Yield Exudyn's methods for a scene as `redundant` has found it, with outputs `interval` s apart."""
    numbers = range(1, MOST + 1)
    explicit = translated.get("tree") == {}  # without joints that close loops
    for element, solver in product(["tree"] if explicit else translated, EXPLICIT if explicit else IMPLICIT):
        yield by_step(f"{element}, {solver}", "number", interval, numbers, element=element, solver=solver)


class Spring(NamedTuple):
    """A spring and damper on a joint coordinate, SI: a control law, or one of the scene's."""

    joint: str
    coordinate: int
    stiffness: float
    damping: float
    rest: float


def _springs(scene: Scene) -> list[Spring]:
    """Return the forces on joint coordinates; raises `CrosscheckError` for what is not translated."""
    springs: list[Spring] = []
    others: list[Any] = [*scene.body_forces, *scene.motions, *scene.armatures, *scene.mechanism.couplings]
    for force in scene.joint_forces:
        if isinstance(force, JointSpring):
            rest = force.rest
        elif (
            isinstance(force, PD)
            and isinstance(force.target, float)
            and force == replace(force, feedforward=0.0, gravity_compensation=False)
        ):
            rest = force.target
        else:
            others.append(force)
            continue
        springs.append(Spring(force.joint, force.coordinate, force.stiffness, force.damping, rest))
    if others:
        raise CrosscheckError(f"{others[0].element} has no translation to Exudyn")
    return springs


def _axes(joint: Any) -> Array:
    """Compute the axes (3, 3) of a joint, columns in the world at the initial pose."""
    if joint.kind == "universal":
        first, second = joint.axis_on_first, joint.axis_on_second
        return np.column_stack([first, second, np.cross(first, second)])
    return np.column_stack([*joint.pair, joint.axis]) if joint.axis_names else np.eye(3)


class Model:
    """A scene in Exudyn; `Bodies` and `Tree` say how its bodies are made.

    Attributes:
        main: Exudyn's MainSystem.
        constraints: numbers of the objects of joints, by name.
    """

    element: ClassVar[str]

    def __init__(self, scene: Scene, left_out: LeftOut) -> None:
        """Translate; `left_out` are numbers of the six rows of joints that are redundant.

        Raises:
            CrosscheckError: for a scene with elements that are not translated.
        """
        import exudyn.itemInterface as items

        self.scene, self.items, self.library = scene, items, library()
        self._container = self.library.SystemContainer()
        self.main = self._container.AddSystem()
        self.ground = self.main.AddObject(items.ObjectGround())
        self.sensors: list[int] = []
        self.constraints: dict[str, int] = {}
        joints, springs = self._make_bodies(_springs(scene))
        for joint in joints:
            self._constrain(joint, left_out.get(joint.name, ()))
        for spring in springs:
            self._connect(scene.mechanism.joint(spring.joint), spring)
        self.main.Assemble()

    def _make_bodies(self, springs: list[Spring]) -> tuple[Sequence[Joint], Sequence[Spring]]:
        """Add bodies and gravity; return the joints and springs that this leaves."""
        raise NotImplementedError

    def _part(self, body: int) -> tuple[Callable[..., Any], Pose]:
        """Return how a marker of a body is made, and its frame in Exudyn at the initial pose."""
        raise NotImplementedError

    def coordinates(self, state: State) -> tuple[Array, Array]:
        """Compute coordinates and velocities (n,) of a state, as Exudyn has them."""
        raise NotImplementedError

    def poses(self, rows: Array) -> Poses:
        """Compute poses from the rows of a run."""
        raise NotImplementedError

    def _keep(self, node: Any, variable: str) -> None:
        """Have coordinates of a node kept at outputs."""
        kind = getattr(self.library.OutputVariableType, variable)
        sensor = self.items.SensorNode(
            nodeNumber=node, outputVariableType=kind, storeInternal=True, writeToFile=False
        )
        self.sensors.append(self.main.AddSensor(sensor))

    def _ends(self, joint: Joint) -> list[Any]:
        """Add markers at both ends of a joint, with its axes."""
        markers = []
        for name, point in ((joint.first, joint.point), (joint.second, joint.reaction_point)):
            make, frame = self._part(self.scene.mechanism.body_index(name))
            place = np.eye(4)
            place[:3, :3], place[:3, 3] = frame.rotation.T @ _axes(joint), frame.point_to_body(point)
            markers.append(self.main.AddMarker(make(localHT=place)))
        return markers

    def _constrain(self, joint: Joint, left_out: Sequence[int]) -> None:
        if joint.kind not in ROWS:
            raise CrosscheckError(f"joint {joint.name!r}, {joint.kind}, has no translation to Exudyn")
        rows = [0 if k in left_out else row for k, row in enumerate(ROWS[joint.kind])]
        spherical = joint.kind == "spherical"  # the generic one keeps multipliers of rotations, too
        make = self.items.ObjectJointSpherical if spherical else self.items.ObjectJointGeneric
        made = make(markerNumbers=self._ends(joint), constrainedAxes=rows[:3] if spherical else rows)
        self.constraints[joint.name] = self.main.AddObject(made)

    def _connect(self, joint: Any, spring: Spring) -> None:
        if joint.coordinate_kinds[spring.coordinate] != "slide" or joint.kind == "planar":
            raise CrosscheckError(f"a force on {joint.kind} {joint.name!r} has no translation to Exudyn")
        connector = self.items.ObjectConnectorLinearSpringDamper(
            markerNumbers=self._ends(joint),
            stiffness=spring.stiffness,
            damping=spring.damping,
            axisMarker0=[0.0, 0.0, 1.0],
            offset=spring.rest + joint.axis @ joint.span,
        )
        self.main.AddObject(connector)

    def start_at(self, q: Array, v: Array) -> None:
        """Set initial coordinates and velocities (n,)."""
        initial = self.library.ConfigurationType.Initial
        self.main.systemData.SetODE2Coordinates(q, configuration=initial)
        self.main.systemData.SetODE2Coordinates_t(v, configuration=initial)

    def solver(self, solver: str, number: int) -> Run:
        """Choose a solver by Exudyn's name, with `number` steps between outputs, which are equally far apart.

        Returns:
            A function that runs from the initial coordinates and returns those at outputs (n, k).
        """
        kind, iteration = getattr(self.library.DynamicSolverType, solver), ITERATIONS[self.element]
        settings = self.library.SimulationSettings()
        settings.solution.file.write = False
        settings.solution.sensors.writePeriod = self.scene.output_period
        settings.cleanUpMemory = False
        settings.linearSolver.solverType = getattr(self.library.LinearSolverType, iteration.linear)
        integration = settings.timeIntegration
        integration.verboseMode = 0
        integration.endTime = self.scene.duration
        integration.numberOfSteps = number * (len(self.scene.times) - 1)
        integration.adaptiveStep = integration.automaticStepSize = False  # steps end at outputs
        integration.newton.useModifiedNewton = iteration.modified
        integration.newton.relativeTolerance = iteration.rtol

        def run() -> Array:
            self.main.SolveDynamic(settings, solverType=kind)
            return np.column_stack([self.main.GetSensorStoredData(k)[:, 1:] for k in self.sensors])

        return run


class Bodies(Model):
    """Rigid bodies with Euler parameters; on the tracker nodes of Lie groups take 1.2 times as long."""

    element = "bodies"

    def _make_bodies(self, springs: list[Spring]) -> tuple[Sequence[Joint], Sequence[Spring]]:
        self._objects, items = [self.ground], self.items
        for body in self.scene.mechanism.bodies[1:]:
            node = self.main.AddNode(
                items.NodeRigidBodyEP(referenceCoordinates=[*body.center_of_mass, *body.quaternion])
            )
            inertia = body.inertia[[0, 1, 2, 1, 0, 0], [0, 1, 2, 2, 2, 1]]
            rigid = items.ObjectRigidBody(mass=body.mass, inertia=inertia, nodeNumber=node)
            self._objects.append(self.main.AddObject(rigid))
            if np.any(self.scene.gravity):
                mass = self.main.AddMarker(items.MarkerBodyMass(bodyNumber=self._objects[-1]))
                weight = items.LoadMassProportional(markerNumber=mass, loadVector=self.scene.gravity)
                self.main.AddLoad(weight)
            self._keep(node, "CoordinatesTotal")
        return self.scene.mechanism.joints, springs

    def _part(self, body: int) -> tuple[Callable[..., Any], Pose]:
        frame = self.scene.mechanism.bodies[body].pose if body else WORLD
        return partial(self.items.MarkerBodyRigid, bodyNumber=self._objects[body]), frame

    def coordinates(self, state: State) -> tuple[Array, Array]:
        q, v = [], []
        for k, body in enumerate(self.scene.mechanism.bodies[1:], 1):
            p = state.quaternion[k]
            p = p if p @ body.quaternion > 0.0 else -p
            omega = rotation(p).T @ state.angular_velocity[k]
            q += [state.position[k] - body.center_of_mass, p - body.quaternion]
            v += [state.linear_velocity[k], 0.5 * (matrix_l(p).T @ omega)]
        return np.concatenate(q), np.concatenate(v)

    def poses(self, rows: Array) -> Poses:
        ground = State.initial(self.scene.mechanism)
        bodies = rows.reshape(len(rows), -1, 7)
        own = np.concatenate([ground.position[0], ground.quaternion[0]])
        every = np.concatenate([np.broadcast_to(own, (len(rows), 1, 7)), bodies], axis=1)
        return every[..., :3], every[..., 3:] / np.linalg.norm(every[..., 3:], axis=-1, keepdims=True)


class Tree(Model):
    """A kinematic tree in newton_euler's joint coordinates, whose loops joints close."""

    element = "tree"

    def _make_bodies(self, springs: list[Spring]) -> tuple[Sequence[Joint], Sequence[Spring]]:
        self._relative = Relative(self.scene)
        tree = self._relative.tree
        self._links = {0: (-1, WORLD)}
        kinds, parents, turns, offsets = [], [], [], []
        masses, centers = np.zeros(tree.nv), np.zeros((tree.nv, 3))
        inertias = np.zeros((tree.nv, 3, 3))
        for kept in tree.joints:
            link, frame = self._links[kept.parent]
            if not kept.motions or any(motion.kind == "ball" for motion in kept.motions):
                raise CrosscheckError("Exudyn's tree has hinges and slides only")
            for motion, point in zip(kept.motions, kept.points, strict=True):
                along = np.column_stack([*perpendicular_pair(motion.axis), motion.axis])
                hinge = motion.kind == "hinge"
                kinds.append(getattr(self.library.JointType, "RevoluteZ" if hinge else "PrismaticZ"))
                parents.append(link)
                turns.append(frame.rotation.T @ along)
                offsets.append(frame.point_to_body(point))
                link, frame = len(kinds) - 1, Pose(point, along)
            body = self.scene.mechanism.bodies[kept.child]
            turn = frame.rotation.T @ body.pose.rotation
            masses[link], inertias[link] = body.mass, turn @ body.inertia @ turn.T
            centers[link] = frame.point_to_body(body.center_of_mass)
            self._links[kept.child] = link, frame
        stiffness, damping, forces, remaining = *np.zeros((3, tree.nv)), []
        for spring in springs:
            if (place := tree.place(spring.joint, spring.coordinate)) is None:
                remaining.append(spring)
                continue
            stiffness[place[1]] += spring.stiffness
            damping[place[1]] += spring.damping
            forces[place[1]] += spring.stiffness * spring.rest
        zeros = [0.0] * tree.nv
        node = self.main.AddNode(self.items.NodeGenericODE2("", zeros, zeros, zeros, tree.nv))
        matrices, vectors = self.library.Matrix3DList, self.library.Vector3DList
        made = self.items.ObjectKinematicTree(
            nodeNumber=node,
            gravity=self.scene.gravity,
            jointTypes=kinds,
            linkParents=parents,
            jointTransformations=matrices(turns),
            jointOffsets=vectors(offsets),
            linkInertiasCOM=matrices(list(inertias)),
            linkCOMs=vectors(list(centers)),
            linkMasses=masses,
            jointPControlVector=stiffness,
            jointDControlVector=damping,
            jointPositionOffsetVector=zeros,
            jointVelocityOffsetVector=zeros,
            jointForceVector=forces,
        )
        self._object = self.main.AddObject(made)
        self._keep(node, "Coordinates")
        return [self.scene.mechanism.joints[k] for k in tree.cuts], remaining

    def _part(self, body: int) -> tuple[Callable[..., Any], Pose]:
        link, frame = self._links[body]
        if body == 0:
            return partial(self.items.MarkerBodyRigid, bodyNumber=self.ground), frame
        marker = self.items.MarkerKinematicTreeRigid
        return partial(marker, objectNumber=self._object, linkNumber=link), frame

    def coordinates(self, state: State) -> tuple[Array, Array]:
        return self._relative.coordinates(state)

    def poses(self, rows: Array) -> Poses:
        states = [self._relative.state(q, np.zeros(self._relative.nv)) for q in rows]
        return np.array([s.position for s in states]), np.array([s.quaternion for s in states])


MODELS: dict[str, type[Model]] = {model.element: model for model in (Bodies, Tree)}


def redundant(scene: Scene) -> dict[str, LeftOut]:
    """Select rows of joints that the others imply, by Exudyn's constraint Jacobian, for each of `MODELS`.

    Raises:
        CrosscheckError: for a scene that neither of them translates, or where Exudyn is not installed.
    """
    found, reasons = {}, []
    for element in MODELS:
        try:
            found[element] = _redundant(scene, element)
        except CrosscheckError as error:
            reasons.append(error)
    if not found:
        raise reasons[0]
    return found


def _redundant(scene: Scene, element: str) -> LeftOut:
    from scipy.linalg import qr

    decided, model = mobility(scene), MODELS[element](scene, {})
    if not model.constraints:
        return {}
    best = max(range(len(decided.states)), key=lambda k: decided.configurations[k].rank)
    q, v = model.coordinates(decided.states[best])
    model.start_at(q, v)
    jacobian = np.array(model.main.ComputeLinearizedSystem(returnConstraintJacobian=True)[-1])
    order = qr(jacobian, mode="r", pivoting=True)[1]
    used = set(order[: len(q) - decided.degrees_of_freedom])
    rows = {name: model.main.systemData.GetObjectLTGAE(k) for name, k in model.constraints.items()}
    return {name: [k for k, row in enumerate(own) if row not in used] for name, own in rows.items()}


@lru_cache(maxsize=1)
def _loaded(path: str) -> tuple[Model, Run, list[tuple[Array, Array]]]:
    """Load a variation, once per process; return its model, solver and initial coordinates."""
    scene, options, left_out, states = pickle.loads(Path(path).read_bytes())
    model = MODELS[options["element"]](scene, left_out)
    starts = [model.coordinates(state) for state in states]
    return model, model.solver(options["solver"], options["number"]), starts


def _run(parameters: Mapping[str, Any]) -> Array | None:
    """Make one run of a variation; None if the solver cannot go on."""
    model, solve, starts = _loaded(parameters["functionData"]["path"])
    model.start_at(*starts[parameters["run"]])
    try:
        rows = solve()
    except model.library.ExudynError:
        return None
    return rows if len(rows) == len(model.scene.times) and np.all(np.isfinite(rows)) else None


def prepare(path: Path, scene: Scene, options: Options, left_out: LeftOut, states: Sequence[State]) -> Model:
    """Write the file of a variation, and load it, for processes that are forked from this one."""
    path.write_bytes(pickle.dumps((scene, options, left_out, states)))
    return _loaded(str(path))[0]


def vary(path: Path, runs: int, processes: int) -> list[Array | None]:
    """Make the runs of a prepared file; return coordinates at outputs (n, k), None for those that failed."""
    from exudyn.processing import ParameterVariation

    _, results = ParameterVariation(
        _run,
        {"run": list(range(runs))},
        useMultiProcessing=processes > 1,
        numberOfThreads=processes,
        showProgress=False,
        parameterFunctionData={"path": str(path)},
    )
    return list(results)
