"""Results of a linearization: the linear model (matrices A, B, C, D) and its modes.

`newton_euler.linearize` makes these records.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

import numpy as np

from newton_euler.model.joint import Key
from newton_euler.model.state import State
from newton_euler.optional_packages import optional_package
from newton_euler.scalars import Array, Floats

RIGID_MODE = 1e-7
"""Magnitude of an eigenvalue, divided by the largest, below which the eigenvalue is zero.

The value is larger than the square root of round-off, the error of double eigenvalues: a motion without a
restoring force has the eigenvalue 0 twice."""

STILL_RATE = 1e-9
"""Rate of a coordinate below which the rate is round-off: divided by the unit of the coordinate and by the
eigenvalue magnitude of the fastest mode (by 1/s if the magnitude is smaller)."""


def label(name: str | Key) -> str:
    """Return the name of a coordinate, an input or an output as one word, such as `joint[1]`."""
    return name if isinstance(name, str) else f"{name[0]}[{name[1]}]"


@dataclass(frozen=True, eq=False)
class Modes:
    """Modes of a linear model, the slowest first: m modes, d coordinates, b bodies; SI.

    A pair of conjugate eigenvalues is one mode, with the positive imaginary part. Zero eigenvalues belong to
    motions without a restoring force.

    Attributes:
        eigenvalues: (m,) 1/s.
        shapes: (m, d) amplitudes of the coordinates, complex, in the scale of `twists`.
        twists: (m, b, 6) displacement of the centers of mass, m, and small rotation, rad, of all bodies,
            world frame; the largest component is 1 rad, or `LinearModel.size`, and real.

    Examples:
        >>> modes: Modes = linearize(load("stewart")).modes()
        >>> print(modes.frequencies.round(1))  # Hz
        [0.9 1.  1.3 1.7 1.9 2. ]
    """

    eigenvalues: Array
    shapes: Array
    twists: Array

    def __repr__(self) -> str:
        return f"<Modes: {', '.join(f'{frequency:.4g}' for frequency in self.frequencies)} Hz>"

    @property
    def frequencies(self) -> Floats:
        """(m,) Hz, damped frequencies; 0 for a mode that does not oscillate."""
        return np.abs(self.eigenvalues.imag) / (2.0 * np.pi)

    @property
    def angular_frequencies(self) -> Floats:
        """(m,) rad/s, undamped frequencies: the magnitudes of the eigenvalues."""
        return np.abs(self.eigenvalues)

    @property
    def damping_ratios(self) -> Floats:
        """(m,) 1 for a mode that does not oscillate, negative for a growing mode, 0 for a zero eigenvalue."""
        size = np.abs(self.eigenvalues)
        return np.where(size > 0.0, -self.eigenvalues.real / np.where(size > 0.0, size, 1.0), 0.0)


@dataclass(frozen=True, eq=False)
class LinearModel:
    """Linear model xdot = f + A x + B u, y = C x + D u near a state of a scene; d coordinates, b bodies.

    x (2 d,) are deviations of independent coordinates and of their rates, u deviations of the inputs, and y
    deviations of the outputs.

    Attributes:
        scene: name of the scene.
        state: state of the linearization.
        coordinates: (d,) names of the coordinates; x has these and then their rates.
        inputs, outputs: names of the entries of u and y.
        units: (d,) units of the coordinates: `size` for slides, m, else 1.
        size: characteristic length of the mechanism, m: the largest distance of joint points and centers of
            mass from their mean.
        A, B, C, D: (2 d, 2 d), (2 d, m), (p, 2 d) and (p, m).
        f: (2 d,) rates of coordinates and their accelerations at the state itself; zero at an equilibrium.
        twists: (b, 6, d) Jacobian of linear and angular velocities of all bodies with respect to the rates of
            the coordinates, world frame.

    Examples:
        >>> model: LinearModel = linearize(load("tracker"))
        >>> print(model.coordinates)
        ('slide_12', 'slide_13')
        >>> print(model.A.round(1) + 0.0)  # the lower rows are the accelerations
        [[  0.    0.    1.    0. ]
         [  0.    0.    0.    1. ]
         [103.1  29.4  -8.    3.5]
         [ 57.5 -76.6   2.8 -36.1]]
    """

    scene: str
    state: State
    coordinates: tuple[str | Key, ...]
    inputs: tuple[str | Key, ...]
    outputs: tuple[str | Key, ...]
    units: Floats
    size: float
    A: Floats
    B: Floats
    C: Floats
    D: Floats
    f: Floats
    twists: Floats

    def __repr__(self) -> str:
        about = f"coordinates: {len(self.coordinates)}, inputs: {len(self.inputs)}"
        return f"<LinearModel of {self.scene!r}: {about}, outputs: {len(self.outputs)}>"

    @property
    def is_equilibrium(self) -> bool:
        """True if the mechanism stays at rest at the state; False if the state moves or accelerates."""
        size = np.tile(self.units, 2)
        fastest = max(np.abs(np.linalg.eigvals(self.A)).max(initial=0.0), 1.0)
        rates, accelerations = np.split(np.abs(self.f / size), 2)
        return bool(
            np.all(rates <= STILL_RATE * fastest) and np.all(accelerations <= STILL_RATE * fastest**2)
        )

    def modes(self) -> Modes:
        """Compute eigenvalues and mode shapes; for a moving state they hold at that instant."""
        # eigenvalues of the dimensionless system that are not zero, one of each conjugate pair, slowest first
        d, size = len(self.units), np.tile(self.units, 2)
        matrix = self.A * size / size[:, None]
        values, vectors = np.linalg.eig(matrix)
        values = values.astype(complex)
        # round-off makes a pair of double real eigenvalues, such as those of critical damping
        values.imag[np.abs(values.imag) < RIGID_MODE * np.abs(values)] = 0.0
        fastest = np.abs(values).max(initial=0.0)
        is_mode = (np.abs(values) > RIGID_MODE * fastest) & (values.imag >= 0.0)
        order = np.flatnonzero(is_mode)[np.argsort(np.abs(values[is_mode]), kind="stable")]
        # motions without a restoring force: null space of the stiffness block of the matrix
        _, stiffness, directions = np.linalg.svd(matrix[d:, :d]) if d else (0, np.zeros(0), np.zeros((0, 0)))
        rigid_shapes = directions[stiffness <= RIGID_MODE**2 * fastest**2]
        eigenvalues = np.concatenate([np.zeros(len(rigid_shapes)), values[order]]).astype(complex)
        shapes = np.concatenate([rigid_shapes, vectors[:d, order].T]).astype(complex) * self.units
        # scale each mode: the largest displacement of a body is 1 rad or `size`, and real; rounded, so that
        # round-off does not choose between equal displacements
        twists = np.einsum("bid,md->mbi", self.twists, shapes)
        scales = np.repeat([self.size, 1.0], 3)
        for shape, twist in zip(shapes, twists, strict=True):
            displacements = (twist / scales).ravel()
            largest = displacements[np.argmax(np.abs(displacements).round(9))]
            shape /= largest
            twist /= largest
        return Modes(eigenvalues, shapes, twists)

    def to_scipy(self) -> Any:
        """Return a `scipy.signal.StateSpace` of A, B, C and D."""
        from scipy.signal import StateSpace

        return StateSpace(self.A, self.B, self.C, self.D)

    def to_control(self) -> Any:
        """Return a `control.StateSpace` of the package control.

        Its signal names have `_` in place of characters that are neither letters nor digits.

        Raises:
            MissingPackageError: if the package control is not installed.
        """
        control = optional_package("control", extra="control")

        def signal_names(names: tuple[str | Key, ...]) -> list[str]:
            """Replace the characters that the package does not allow."""
            return [re.sub(r"\W+", "_", label(name)).strip("_") for name in names]

        coordinates = signal_names(self.coordinates)
        return control.StateSpace(
            self.A,
            self.B,
            self.C,
            self.D,
            states=[*coordinates, *(f"{name}_rate" for name in coordinates)],
            inputs=signal_names(self.inputs),
            outputs=signal_names(self.outputs),
        )
