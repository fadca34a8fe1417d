"""Sensitivities: derivatives of trajectories with respect to parameters of a scene.

The equations of motion are differentiated symbolically and compiled. Their derivatives are integrated along
the steps of a run (`newton_euler.integrators.tangent_steps`), on the linearized constraints. The run itself
is bitwise equal to a run without derivatives. A step that is too long for the derivatives, for example of a
mechanism at rest, is divided. In each part of a step, and for each parameter, the error of the derivatives of
coordinates is at most 100 `rtol` times the largest of these derivatives. The same holds for velocities.
Round-off and singular configurations are excepted.

Times of discontinuities must not depend on parameters. Set-points that jump and knots of splines have fixed
times. A run is refused if a spring force jumps in the motion: a spring on a ball that passes half a
revolution, or a spring with a rest length whose ends meet. Sampled controllers have no derivatives. Near
singular configurations derivatives lose digits like accelerations, and a run that comes too near is refused.
The required distance is larger for parameters that change the configurations in which loops close.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Unpack

import numpy as np
from numpy.typing import ArrayLike

from newton_euler.analysis.sensitivity.tangent_code import ALONG, tangent_code
from newton_euler.analysis.sensitivity.tangent_run import TangentRun, tangent_options
from newton_euler.analysis.sensitivity.tangent_starts import Starts, components
from newton_euler.arguments import checked
from newton_euler.compiled.formulations import check_formulation
from newton_euler.compiled.outputs import named
from newton_euler.equations.undetermined import redundant_constraints
from newton_euler.errors import OptionError, SensitivityError
from newton_euler.integrators.options import FormulationName, StepControl
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import JointMotion, Trajectory, coordinate_names
from newton_euler.runs.simulate import native_trajectory
from newton_euler.runs.variation import checked_values, own_values
from newton_euler.scalars import Floats


@dataclass(frozen=True, eq=False)
class Sensitivities:
    """Derivatives of a run with respect to p parameters at its n output times; SI.

    b bodies, j joints, a actuators. The arrays are those of a trajectory, with a last dimension for the
    parameters: `position[..., k]` is the derivative of `run.position` with respect to `parameters[k]`. Arrays
    that are not outputs of the scene are None; so are reactions if constraints are redundant. Bodies and
    joints have the names of the trajectory: `by.position[:, by.body_names.index("panel_7")]` are derivatives
    of the positions of one body.

    Attributes:
        run: the run itself, bitwise equal to that of `compile_scene(scene, parameters=...)`.
        parameters: names of the p numbers.

    Examples:
        >>> by: Sensitivities = sensitivities(load("pendulum"), ["dumbbell.mass", "gravity"])
        >>> by  # gravity has three components
        <Sensitivities of newton_euler: 1001 outputs to 10 s, parameters: 4>
        >>> bob, mass = by.run.body_names.index("dumbbell"), by.parameters.index("dumbbell.mass")
        >>> print(by.position[-1, bob, :, mass].round(3))  # m/kg, along x, y, z at the end
        [ 2.61  -0.747  0.   ]
    """

    run: Trajectory
    parameters: tuple[str, ...]
    position: Floats
    """(n, b, 3, p) of centers of mass."""
    quaternion: Floats
    """(n, b, 4, p)"""
    linear_velocity: Floats | None = None
    """(n, b, 3, p)"""
    angular_velocity: Floats | None = None
    """(n, b, 3, p)"""
    reaction_force: Floats | None = None
    """(n, j, 3, p)"""
    reaction_torque: Floats | None = None
    """(n, j, 3, p)"""
    actuator_force: Floats | None = None
    """(n, a, p)"""
    kinetic_energy: Floats | None = None
    """(n, p)"""
    potential_energy: Floats | None = None
    """(n, p)"""
    work: Floats | None = None
    """(n, p)"""
    _coordinates: Floats = field(default_factory=lambda: np.zeros(0), repr=False)
    """(n, 2 c, p) of the c coordinates of all joints, then of their rates."""

    def __repr__(self) -> str:
        time = self.run.time
        size = f"{len(time)} outputs to {time[-1]:g} s, parameters: {len(self.parameters)}"
        return f"<Sensitivities of {self.run.engine}: {size}>"

    @property
    def body_names(self) -> tuple[str, ...]:
        """Names of the b bodies."""
        return self.run.body_names

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the j joints."""
        return self.run.joint_names

    def joint(self, name: str) -> JointMotion:
        """Return the derivatives (n, k, p) of the coordinates of a joint, and of their rates.

        Raises:
            UnknownNameError: for an unknown joint.
        """
        mechanism = self.run.mechanism
        assert mechanism is not None
        counts = [len(equations.coordinates) for equations in mechanism.equations]
        number = mechanism.joint_index(name)
        place = slice(sum(counts[:number]), sum(counts[: number + 1]))
        x, rates = np.split(self._coordinates, 2, axis=1)
        has_rates = self.run.linear_velocity is not None
        names = coordinate_names(mechanism.joints[number])
        return JointMotion(names, x[:, place], rates[:, place] if has_rates else None)


@checked
def sensitivities(
    scene: Scene,
    parameters: Sequence[str] | Mapping[str, ArrayLike],
    formulation: FormulationName | None = None,
    **control: Unpack[StepControl],
) -> Sensitivities:
    """Run a scene and differentiate its trajectory with respect to parameters.

    Args:
        scene: the scene to run, by DOP853 with projection.
        parameters: names, see `newton_euler.equations.parameters`, and for initial coordinates
            `newton_euler.runs.initial_coordinates`. An array stands for all of its numbers. Or values by
            name: the run is then the one that `simulate_batch` makes with these values, and all values share
            the compiled code. If the rate `start.JOINT.rate` is a parameter, the initial coordinate
            `start.JOINT` is constant, also for derivatives with respect to geometry. If neither is a
            parameter, the initial coordinate changes with the geometry as the loops require.
        formulation: see `newton_euler.simulate`.
        control: options of the steps of DOP853, see `StepControl`; other methods have no derivatives.

    Raises:
        NewtonEulerError: for an unknown name, an impossible option, a run that stops, or a run without
            (known) derivatives.

    Examples:
        >>> by = sensitivities(load("tracker"), ["panel_7.mass", "slide_12.stiffness"])
        >>> by.run.position.shape[1:], by.position.shape[1:]
        ((7, 3), (7, 3, 2))
        >>> lighter = sensitivities(load("pendulum"), {"dumbbell.mass": 0.5})
        >>> lighter.parameters
        ('dumbbell.mass',)
    """
    # numbers of the parameters
    check_formulation(formulation)
    names = checked_names(list(parameters) if isinstance(parameters, Mapping) else parameters)
    options, places = tangent_options(control), components(scene, names)
    if isinstance(parameters, Mapping):
        values = checked_values(scene, parameters)
    else:
        values = own_values(scene, names)
    labels = tuple(places)  # a name for each number
    # the run with its derivatives
    code = tangent_code(scene, labels, formulation)
    code.warn()  # of almost redundant constraints
    numbers = np.array([values[name][index] for name, index in places.values()])
    # start state with parameters (inputs,), and its derivatives (inputs, p)
    x, directions = Starts(code, labels)(numbers)
    tangent_run = TangentRun(code, options, ("output", "coordinates"))(x, directions)
    # the trajectory, and derivatives in its shapes: names with `ALONG` are those of compiled functions that
    # compute derivatives
    settings = code.settings | options.as_settings() | tangent_run.counts
    outputs = named(code, tangent_run.results)
    quaternion = outputs["quaternion"].copy()
    run = native_trajectory(scene, settings, tangent_run.wall_time, outputs)
    run = replace(run, mechanism=code.parametrized(x).mechanism)
    arrays = {
        name: tangent_run.derivatives["output"][:, start:stop].reshape(len(run.time), *shape, len(labels))
        for name, (start, stop, shape) in code.function("output" + ALONG).layout.items()
    }
    if redundant_constraints(scene):
        arrays.pop("reaction_force", None)
        arrays.pop("reaction_torque", None)
    # a trajectory changes the signs of quaternions, so that they are continuous in time
    signs = np.sign(np.sum(quaternion * run.quaternion, axis=2))
    arrays["quaternion"] = arrays["quaternion"] * signs[:, :, None, None]
    for name, array in arrays.items():
        if not np.isfinite(array).all():
            raise SensitivityError(f"derivatives of {name} are not finite")
    # the compiled function "coordinates" returns joint coordinates and rates, then their derivatives
    _, coordinate_derivatives = np.split(tangent_run.derivatives["coordinates"], 2, axis=1)
    return Sensitivities(run, labels, **arrays, _coordinates=coordinate_derivatives)


def checked_names(parameters: Sequence[str]) -> tuple[str, ...]:
    """Check that names of parameters are given, at least one, each once; raises `OptionError`."""
    valid = isinstance(parameters, list | tuple) and all(isinstance(name, str) for name in parameters)
    if not valid or not 0 < len(set(parameters)) == len(parameters):
        needed = "names of parameters, one or more, each once, or values by name"
        raise OptionError("parameters", parameters, needed)
    return tuple(parameters)
