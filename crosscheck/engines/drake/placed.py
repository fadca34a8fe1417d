"""Drake's plant at a state of the spanning tree: kinematics, mass matrix, forces and forward dynamics.

Tree coordinates q (tree.nq,) and velocities v (nv,) are those of `newton_euler.model.spanning_tree`: zero at
the initial pose, quaternions (w, x, y, z) and angular velocities of balls in the frame of the child. Twists
and wrenches (6,) have linear before angular components, world frame.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from pydrake.common.value import Value
from pydrake.math import RollPitchYaw, RotationMatrix
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.plant import ExternallyAppliedSpatialForce
from pydrake.multibody.tree import JacobianWrtVariable, MultibodyForces

from crosscheck.engines.drake.plant import Plant
from newton_euler.errors import SingularityError
from newton_euler.model.euler_parameters import rotation
from newton_euler.scalars import Array

KV = JacobianWrtVariable.kV


class PlacedPlant:
    """A finalized continuous plant with its present state.

    Attributes:
        built: the plant and its parts.
        plant: the `MultibodyPlant`.
        context: Drake's context with the present state.
    """

    def __init__(self, built: Plant) -> None:
        """Finalize the plant."""
        self.built, self.plant = built, built.plant
        self._tree = built.welded.tree
        self.plant.Finalize()
        self.context = self.plant.CreateDefaultContext()
        self._world = self.plant.world_frame()
        self._at: tuple[bytes, bytes] | None = None
        self._to_drake = np.eye(self._tree.nv)
        self.load(np.zeros(self._tree.nv), np.zeros((len(built.bodies), 6)))

    @contextmanager
    def _errors(self) -> Iterator[None]:
        """Turn an exception of Drake at the present state into a `SingularityError`."""
        try:
            yield
        except RuntimeError as error:
            raise SingularityError(None, f"Drake: {str(error).splitlines()[0]}") from error

    # The state

    def place(self, q: Array, v: Array) -> None:
        """Set the plant to tree coordinates q (tree.nq,) and velocities v (nv,).

        Raises:
            SingularityError: for numbers that are not finite, for which Drake would end the process.
        """
        state = q.tobytes(), v.tobytes()
        if state == self._at:
            return
        positions, to_drake = self.positions(q)
        velocities = to_drake @ v
        if not (np.isfinite(positions).all() and np.isfinite(velocities).all()):
            raise SingularityError(None, "the state is not finite")
        self.plant.SetPositions(self.context, positions)
        self.plant.SetVelocities(self.context, velocities)
        self._at, self._to_drake = state, to_drake

    def place_initially(self) -> None:
        """Set the plant to the initial pose, at rest."""
        q = np.zeros(self._tree.nq)
        q[[place.start for place in self._tree.quaternions]] = 1.0
        self.place(q, np.zeros(self._tree.nv))

    def positions(self, q: Array) -> tuple[Array, Array]:
        """Return Drake's positions at tree coordinates q (tree.nq,), and the matrix (nv, nv) from v to its
        velocities."""
        positions = np.zeros(self.plant.num_positions())
        to_drake = np.zeros((self._tree.nv, self._tree.nv))
        for joint, (motion, on_q, on_v) in zip(self.built.motions, self._tree.motions, strict=True):
            in_q, in_v = joint.position_start(), joint.velocity_start()
            if motion.kind != "ball":
                positions[in_q], to_drake[in_v, on_v.start] = q[on_q.start], 1.0
                continue
            turn = rotation(q[on_q] / np.linalg.norm(q[on_q]))
            to_drake[in_v : in_v + 3, on_v] = turn
            if np.isfinite(turn).all():
                positions[in_q : in_q + 3] = RollPitchYaw(RotationMatrix(turn)).vector()
            else:
                positions[in_q : in_q + 3] = np.nan
        return positions, to_drake

    # Kinematics of frames

    def pose(self, frame: Any) -> tuple[Array, Array]:
        """Return the origin (3,), m, and the rotation matrix (3, 3) of a frame."""
        found = frame.CalcPoseInWorld(self.context)
        return found.translation(), found.rotation().matrix()

    def velocity(self, frame: Any) -> Array:
        """Return the velocity (6,) of a frame."""
        found = frame.CalcSpatialVelocityInWorld(self.context)
        return np.concatenate([found.translational(), found.rotational()])

    def jacobian(self, frame: Any) -> Array:
        """Return the Jacobian (6, nv) of the velocity of a frame with respect to tree velocities."""
        found = self.plant.CalcJacobianSpatialVelocity(
            self.context, KV, frame, np.zeros(3), self._world, self._world
        )
        return np.concatenate([found[3:], found[:3]]) @ self._to_drake

    def bias(self, frame: Any) -> Array:
        """Return the acceleration (6,) of a frame for dv/dt = 0.

        Velocities of balls are w in the tree and R w in Drake. The rotation R turns with R w, so that Drake's
        rates are zero, too, if dw/dt = 0.
        """
        found = self.plant.CalcBiasSpatialAcceleration(
            self.context, KV, frame, np.zeros(3), self._world, self._world
        )
        return np.concatenate([found.translational(), found.rotational()])

    # Dynamics of the tree

    def mass_matrix(self) -> Array:
        """Return the mass matrix (nv, nv), with rotors on hinges and slides."""
        return np.asarray(self._to_drake.T @ self.plant.CalcMassMatrix(self.context) @ self._to_drake)

    def force(self, along: Array, wrenches: Array) -> Array:
        """Return the force (nv,) of M dv/dt = f: gravity, velocity terms, Drake's springs and given forces.

        Args:
            along: (nv,) forces on the tree velocities, N or N m.
            wrenches: (b, 6) forces and torques about the centers of mass.
        """
        plant, context = self.plant, self.context
        forces = MultibodyForces(plant)
        with self._errors():
            plant.CalcForceElementsContribution(context, forces)
        forces.mutable_generalized_forces()[:] += self._to_drake @ along
        for body in np.flatnonzero(np.any(wrenches != 0.0, axis=1)):
            wrench = SpatialForce(tau=wrenches[body, 3:], f=wrenches[body, :3])
            self.built.bodies[body].AddInForce(context, np.zeros(3), wrench, self._world, forces)
        inverse = plant.CalcInverseDynamics(context, np.zeros(self._tree.nv), forces)
        return np.asarray(-(self._to_drake.T @ inverse))

    def energies(self) -> tuple[float, float]:
        """Return the kinetic energy, and the potential energy of gravity and of Drake's springs, J."""
        kinetic = self.plant.CalcKineticEnergy(self.context)
        return float(kinetic), float(self.plant.CalcPotentialEnergy(self.context))

    def load(self, along: Array, wrenches: Array) -> None:
        """Set the given forces of Drake's forward dynamics; for the arguments see `force`."""
        loads = spatial_forces(self.built.bodies, wrenches)
        self.plant.get_applied_generalized_force_input_port().FixValue(self.context, self._to_drake @ along)
        self.plant.get_applied_spatial_force_input_port().FixValue(self.context, loads)

    def transmitted(self, along: Array, wrenches: Array) -> tuple[Array, Array]:
        """Solve Drake's forward dynamics of the tree under given forces.

        Returns:
            (nv,) accelerations dv/dt; for each joint of the tree the wrench (6,) on its child, about the
            origin of the world, with the forces along the coordinates of the joint.
        """
        self.load(along, wrenches)
        with self._errors():
            acceleration = self.plant.get_generalized_acceleration_output_port().Eval(self.context)
            reactions = self.plant.get_reaction_forces_output_port().Eval(self.context)
        found = np.zeros((len(self.built.last), 6))
        for wrench, joint in zip(found, self.built.last, strict=True):
            # Drake's reaction is on the child, at the joint's frame there, and in the axes of this frame
            point, turn = self.pose(joint.frame_on_child())
            reaction = reactions[int(joint.index())]
            wrench[:3] = turn @ reaction.translational()
            wrench[3:] = turn @ reaction.rotational() + np.cross(point, wrench[:3])
        return self._to_drake.T @ acceleration, found


def spatial_forces(bodies: list[Any], wrenches: Array) -> Any:
    """Return wrenches (b, 6) about the centers of mass as the value of Drake's port of applied forces."""
    loads = []
    for body, wrench in zip(bodies[1:], wrenches[1:], strict=False):
        if np.any(wrench):
            load = ExternallyAppliedSpatialForce()
            load.body_index, load.p_BoBq_B = body.index(), np.zeros(3)
            load.F_Bq_W = SpatialForce(tau=wrench[3:], f=wrench[:3])
            loads.append(load)
    return Value[list[ExternallyAppliedSpatialForce]](loads)
