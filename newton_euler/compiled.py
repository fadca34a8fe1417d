"""A scene compiled: its equations traced, pruned to what is wanted, and turned into native code.

All functions take one vector x = (q, v, time, parameters) and write one vector. `derivative` and the
two projection functions follow the conventions of `newton_euler.march`.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np

from newton_euler.cartesian import Cartesian
from newton_euler.compile import NativeFunction, compile_programs
from newton_euler.expression import Graph, Program
from newton_euler.relative import Relative
from newton_euler.scalars import Array, Scalar, minimum
from newton_euler.sparse import dot, factorise, minimum_degree, rows_of, sparse_vector

Formulation = Relative | Cartesian


class CompiledSystem:
    """Native functions of one formulation of a scene.

    Attributes:
        system: the formulation, whose float form is the reference.
        programs: what was traced, by name.
        functions: the same in native code.
    """

    def __init__(self, system: Formulation) -> None:
        self.system = system
        self.size = system.nq + system.nv

    @cached_property
    def programs(self) -> dict[str, Program]:
        """Traced and pruned: derivative, position, velocity."""
        return {
            "derivative": self._trace(self._derivative),
            "position": self._trace(self._position),
            "velocity": self._trace(self._velocity),
            "rate": self._trace(self._rate),
        }

    @cached_property
    def functions(self) -> dict[str, NativeFunction]:
        return compile_programs(self.programs | {"output": self.output[1]})

    def load(self) -> None:
        """Trace and compile now, so that no run has to wait for it."""
        assert self.functions

    def _trace(self, function: Any) -> Program:
        graph = Graph()
        y = graph.variables(self.size + 1)
        return graph.prune(function(y[: self.system.nq], y[self.system.nq : self.size]))

    def _derivative(self, q: Array, v: Array) -> list[Scalar]:
        """(qdot, vdot, health)."""
        acceleration, health = self.system.sparse_acceleration(q, v)
        return [*self.system.rate(q, v), *acceleration, health]

    def _rate(self, q: Array, v: Array) -> list[Scalar]:
        """qdot."""
        return [*self.system.rate(q, v)]

    def _position(self, q: Array, v: Array) -> list[Scalar]:
        """(q after one Newton step, v, squared residual before it, health)."""
        q = self.system.retract(q, np.zeros(self.system.nv))  # quaternions of norm 1
        phi, jacobian = self.system.phi_and_jacobian(q)
        step, health = self._least(jacobian, phi)
        return [*self.system.retract(q, -step), *v, phi @ phi, health]

    def _velocity(self, q: Array, v: Array) -> list[Scalar]:
        """(q, v on the constraints, squared residual of positions, health)."""
        phi, jacobian = self.system.phi_and_jacobian(q)
        step, health = self._least(jacobian, jacobian @ v)
        return [*q, *(v - step), phi @ phi, health]

    def _least(self, jacobian: Array, right: Array) -> tuple[Array, Scalar]:
        """The shortest dimensionless x with J x = right, and the health of J J^T."""
        units = self.system.velocity_units
        rows = rows_of(jacobian * units)
        gram = [{j: dot(a, b) for j, b in enumerate(rows) if a.keys() & b.keys()} for a in rows]
        factor = factorise(gram, minimum_degree([set(row) for row in gram]))
        weights = factor.solve(sparse_vector(right))
        x: list[Scalar] = [0.0] * len(units)
        for i, weight in weights.items():
            for k, entry in rows[i].items():
                x[k] = x[k] + entry * weight
        return np.array([units[k] * value for k, value in enumerate(x)]), minimum(factor.health, 1.0)

    # Outputs

    @cached_property
    def output(self) -> tuple[dict[str, tuple[slice, tuple[int, ...]]], Program]:
        """What the scene asks for at a state: where each array is in the outputs, its shape, the program."""
        graph = Graph()
        y = graph.variables(self.size + 1)
        q, v = y[: self.system.nq], y[self.system.nq : self.size]
        e, wanted = self.system.sparse_evaluation(q, v), self.system.scene.outputs
        arrays = {"position": e.state.position, "quaternion": e.state.quaternion}
        if "velocities" in wanted:
            arrays["linear_velocity"] = e.state.linear_velocity
            arrays["angular_velocity"] = e.state.angular_velocity
        if "reactions" in wanted:
            arrays["reaction_force"], arrays["reaction_torque"] = e.reaction_force, e.reaction_torque
        if "actuation" in wanted:
            arrays["actuator_force"] = e.actuator_force
        if "energy" in wanted:
            arrays["kinetic_energy"] = np.array(e.kinetic_energy)
            arrays["potential_energy"] = np.array(e.potential_energy)
        if "violation" in wanted:
            arrays["phi"] = self.system.joint_phi(q)
        places: dict[str, tuple[slice, tuple[int, ...]]] = {}
        scalars: list[Scalar] = []
        for name, array in arrays.items():
            places[name] = (slice(len(scalars), len(scalars) + array.size), array.shape)
            scalars.extend(array.ravel())
        return places, graph.prune(scalars)
