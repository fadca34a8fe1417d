"""Outputs of a file's run in MuJoCo: poses, energies, loop errors, and events.

An event is the first action of a contact, limit or dry friction that the scene imported from the file does
not have. `mjcf.file_run` makes the runs.
"""

from __future__ import annotations

from collections.abc import Mapping, Set
from typing import Any

import mujoco
import numpy as np

from mjcf.layout import element_name
from newton_euler.model.euler_parameters import continuous
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import Trajectory
from newton_euler.reading.file_run import CONTACT_OF, Event, LoopErrors
from newton_euler.reading.import_report import FRICTION, LIMITS
from newton_euler.runs.assemble import initial_state
from newton_euler.scalars import Array

EVENT_KINDS = {
    mujoco.mjtConstraint.mjCNSTR_LIMIT_JOINT: (LIMITS, "joint"),
    mujoco.mjtConstraint.mjCNSTR_LIMIT_TENDON: (LIMITS, "tendon"),
    mujoco.mjtConstraint.mjCNSTR_FRICTION_DOF: (FRICTION, "joint"),
    mujoco.mjtConstraint.mjCNSTR_FRICTION_TENDON: (FRICTION, "tendon"),
}
"""Topic, as in the import report, and kind of element of limits and dry friction, by type of MuJoCo's
constraint rows."""


class Recorder:
    """Poses of rigid groups, energies and loop errors at the outputs of a run.

    Attributes:
        times: s.
        positions: for each output, centers of mass (g, 3) of the g rigid groups, m, world frame.
        quaternions: for each output, orientations (g, 4) of the root bodies of the groups.
        energies: for each output, potential and kinetic energy, J.
        openings: for each output, violations (neq,) of the equalities, m; 0 for those of angles.
        angles: for each output, violations (neq,) of the equalities, rad; 0 for those of lengths.
        states: for each output, configuration (nq,), velocities (nv,) and activations (na,).
    """

    def __init__(self, model: Any, data: Any, groups: list[tuple[int, Array]]) -> None:
        """Take a model and the data of the run; `groups` are root body and members of each rigid group."""
        self._model, self._data = model, data
        self._roots = np.array([root for root, _ in groups], dtype=int)
        # mass of each body of the model as a fraction of the mass of each group (g, nbody)
        self._mass_fractions = np.zeros((len(groups), model.nbody))
        for fractions, (_, members) in zip(self._mass_fractions, groups, strict=True):
            fractions[members] = model.body_mass[members] / max(model.body_mass[members].sum(), 1e-300)
        self._output_data = mujoco.MjData(model)  # so that outputs do not change the warm start of the run
        self.times: list[float] = []
        self.positions: list[Array] = []
        self.quaternions: list[Array] = []
        self.energies: list[Array] = []
        self.openings: list[Array] = []
        self.angles: list[Array] = []
        self.states: list[tuple[Array, Array, Array]] = []
        self._is_weld = model.eq_type == mujoco.mjtEq.mjEQ_WELD
        self._is_angle = np.array([_is_angle(model, k) for k in range(model.neq)], dtype=bool)

    def record(self) -> None:
        """Add the present state as an output."""
        model, output = self._model, self._output_data
        output.qpos[:], output.qvel[:] = self._data.qpos, self._data.qvel
        output.eq_active[:] = self._data.eq_active
        self.states.append((self._data.qpos.copy(), self._data.qvel.copy(), self._data.act.copy()))
        mujoco.mj_fwdPosition(model, output)
        mujoco.mj_fwdVelocity(model, output)
        mujoco.mj_energyPos(model, output)
        mujoco.mj_energyVel(model, output)
        self.times.append(self._data.time)
        self.positions.append(self._mass_fractions @ output.xipos)
        self.quaternions.append(output.xquat[self._roots])
        self.energies.append(np.array(output.energy))
        self._record_loops()

    def _record_loops(self) -> None:
        """Add the violations of all equalities: the rows of each one follow each other."""
        model, output = self._model, self._output_data
        rows = np.flatnonzero(output.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY)
        equality, residual = output.efc_id[rows], output.efc_pos[rows]
        # of a weld, the last three rows are half of a small rotation, times the torque scale
        number_in_equality = np.arange(len(rows)) - np.searchsorted(equality, equality)
        turns = self._is_weld[equality] & (number_in_equality >= 3)
        residual = np.where(turns, 2.0 * residual / np.maximum(model.eq_data[equality, 10], 1e-300), residual)
        is_angle = turns | self._is_angle[equality]
        for kept, into in ((~is_angle, self.openings), (is_angle, self.angles)):
            squares = np.bincount(equality, weights=kept * residual**2, minlength=model.neq)
            into.append(np.sqrt(squares))

    def loop_errors(self) -> LoopErrors:
        """Return the violations of the equalities that are switched on at the recorded times."""
        bits = mujoco.mjtDisableBit
        off = self._model.opt.disableflags & (bits.mjDSBL_EQUALITY | bits.mjDSBL_CONSTRAINT)
        active = np.flatnonzero(self._data.eq_active * (not off))
        names = tuple(element_name(self._model, "equality", int(k)) for k in active)
        return LoopErrors(
            names,
            np.array(self.openings)[:, active],
            np.array(self.angles)[:, active],
            have_lengths=~self._is_angle[active],
            have_angles=(self._is_weld | self._is_angle)[active],
        )

    def trajectory(
        self,
        engine: str,
        scene: Scene,
        names: tuple[str, ...],
        settings: Mapping[str, Any],
        thread_time: float,
    ) -> Trajectory:
        """Return the motion of the scene's bodies.

        Args:
            engine: name and version of the engine.
            scene: imported scene.
            names: name of the scene's body for each rigid group; other bodies rest.
            settings: settings of the run, by name.
            thread_time: processor time of the steps, s.
        """
        bodies = scene.mechanism.body_names
        count = len(self.times)
        position, quaternion = np.zeros((count, len(bodies), 3)), np.zeros((count, len(bodies), 4))
        position[:], quaternion[:] = initial_state(scene).position, initial_state(scene).quaternion
        for group, name in enumerate(names):
            body = bodies.index(name)
            position[:, body] = np.array(self.positions)[:, group]
            quaternion[:, body] = np.array(self.quaternions)[:, group]
        potential, kinetic = np.array(self.energies).T
        return Trajectory(
            engine=engine,
            settings=dict(settings),
            wall_time=thread_time,  # here processor time of the steps alone
            time=np.array(self.times),
            body_names=bodies,
            joint_names=scene.mechanism.joint_names,
            position=position,
            # signs of quaternions such that they do not jump from output to output
            quaternion=continuous(quaternion, quaternion[0]),
            kinetic_energy=kinetic,
            potential_energy=potential,
            mechanism=scene.mechanism,
        )


class EventRecorder:
    """First contact of each pair of bodies, and first action of each limit and dry friction, in a run.

    Limits and dry friction that the imported scene has as forces are no events.

    Attributes:
        events: events so far, in the order of time.
    """

    def __init__(self, model: Any, data: Any, simulated: Set[tuple[str, str]]) -> None:
        """Take a model and the data of the run.

        Args:
            model, data: model and data.
            simulated: elements and topics that the scene has, see `ImportReport.approximated_topics`.
        """
        self._model, self._data, self._simulated = model, data, simulated
        # (type of constraint row, number of the element), or numbers of the bodies of a contact
        self._known_limits: set[tuple[int, int]] = set()
        self._known_contacts: set[tuple[int, ...]] = set()
        self.events: list[Event] = []

    def record(self) -> None:
        """Add an event for each element that acts in the last step for the first time."""
        model, data = self._model, self._data
        # the first `ne` of the `nefc` constraint rows are those of equalities
        if data.nefc == data.ne:
            return
        row_types, numbers = data.efc_type[data.ne :], data.efc_id[data.ne :]
        for row_type, number in {*zip(row_types.tolist(), numbers.tolist(), strict=True)}:
            topic_and_kind = EVENT_KINDS.get(mujoco.mjtConstraint(row_type))
            if topic_and_kind is None:  # a contact; the numbers of contacts change from step to step
                contact = data.contact[number]
                bodies = tuple(sorted(int(model.geom_bodyid[geom]) for geom in contact.geom if geom >= 0))
                if bodies not in self._known_contacts:
                    self._known_contacts.add(bodies)
                    names = " and ".join(repr(model.body(body).name or f"body {body}") for body in bodies)
                    self._add_event(f"{CONTACT_OF}{names}")
            elif (row_type, number) not in self._known_limits:
                self._known_limits.add((row_type, number))
                topic, kind = topic_and_kind
                # MuJoCo numbers the friction of joints by degree of freedom
                is_of_dof = topic == FRICTION and kind == "joint"
                owner = int(model.dof_jntid[number]) if is_of_dof else number
                element = element_name(model, kind, owner)
                if (element, topic) not in self._simulated:
                    self._add_event(f"{topic} of {element}")

    def _add_event(self, element: str) -> None:
        """Add an event of an element at the beginning of the last step."""
        self.events.append(Event(float(self._data.time - self._model.opt.timestep), element))


def _is_angle(model: Any, equality: int) -> bool:
    """Return whether an equality constrains an angle: of a hinge, or of a tendon over hinges."""
    hinges = mujoco.mjtJoint.mjJNT_HINGE
    first = int(model.eq_obj1id[equality])
    match mujoco.mjtEq(model.eq_type[equality]):
        case mujoco.mjtEq.mjEQ_JOINT:
            return bool(model.jnt_type[first] == hinges)
        case mujoco.mjtEq.mjEQ_TENDON:
            start, count = int(model.tendon_adr[first]), int(model.tendon_num[first])
            wraps = slice(start, start + count)
            joints = model.wrap_objid[wraps][model.wrap_type[wraps] == mujoco.mjtWrap.mjWRAP_JOINT]
            return bool(len(joints) == count and np.all(model.jnt_type[joints] == hinges))
        case _:
            return False
