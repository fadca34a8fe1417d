"""Newton-Euler dynamics of mechanisms with closed loops.

A `Scene` is a `Mechanism` of bodies and joints with forces, control laws, an initial state and a duration.
`simulate` runs a scene and returns a `Trajectory`. Other functions compute poses, linear models, loads,
sensitivities and identified parameters. This file exports the public names of the package; those that
compute are imported at their first use. To read the source, start with `newton_euler.runs.simulate`.

Examples in docstrings, here and in the packages crosscheck, mjcf and urdf, assume these imports:
`from newton_euler import *`, `from crosscheck.library import load`, `from crosscheck import *`,
`from dataclasses import replace`, `import numpy as np` and `import mjcf, urdf`.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from newton_euler.errors import (
    ArgumentError,
    BranchWarning,
    IdentificationWarning,
    NearlyRedundantWarning,
    NewtonEulerError,
    RoundOffWarning,
)
from newton_euler.model.armatures import Armature, BallArmature
from newton_euler.model.compound_joint import Compound
from newton_euler.model.control import PD, ComputedTorque, StateFeedback
from newton_euler.model.couplings import Gear, LinearCoupling, PolynomialCoupling
from newton_euler.model.digital_control import Digital, Sampled
from newton_euler.model.forces import BallSpring, JointSpring, PointSpring, Wrench
from newton_euler.model.geometry import Box, Capsule, Cylinder, Mesh, Sphere
from newton_euler.model.joint_kinds import (
    Cylindrical,
    Fixed,
    Free,
    Planar,
    PointOnLine,
    Prismatic,
    Revolute,
    Rod,
    Screw,
    Spherical,
    Translational,
    Universal,
)
from newton_euler.model.mechanism import Body, Mechanism
from newton_euler.model.motions import PrescribedMotion, Sum
from newton_euler.model.parallel_hinges import ParallelHinges
from newton_euler.model.scene import Scene
from newton_euler.model.smooth_functions import Polynomial, Sine
from newton_euler.model.splines import Moves, Spline, Steps
from newton_euler.model.state import State
from newton_euler.model.switched_forces import ElasticGear, JointFriction, JointStop
from newton_euler.model.trajectory import Trajectory
from newton_euler.model.wind import WindLoad, vertical_turbulence, wind_gust, wind_turbulence

if TYPE_CHECKING:
    from newton_euler.analysis.identification.identify import Identification, identify
    from newton_euler.analysis.identification.measurements import Measurements, measurements_from_csv
    from newton_euler.analysis.kinematics.branches import Branches, assembly_branches
    from newton_euler.analysis.kinematics.configurations import Axis
    from newton_euler.analysis.kinematics.point import Point
    from newton_euler.analysis.kinematics.poses import Poses, solve_poses
    from newton_euler.analysis.kinematics.workspace import Workspace, singular_poses, workspace
    from newton_euler.analysis.linear.linear_model import LinearModel, Modes
    from newton_euler.analysis.linear.linearization import linearize
    from newton_euler.analysis.linear.regulator import lqr
    from newton_euler.analysis.loads.envelope import LoadEnvelope, LoadRange, load_envelope
    from newton_euler.analysis.loads.equilibrium import equilibrium
    from newton_euler.analysis.loads.inverse_dynamics import Loads, inverse_dynamics
    from newton_euler.analysis.loads.rest import rest_case
    from newton_euler.analysis.loads.statics import statics
    from newton_euler.analysis.sensitivity.sensitivities import Sensitivities, sensitivities
    from newton_euler.runs.assemble import assemble, initial_state
    from newton_euler.runs.batch import simulate_batch
    from newton_euler.runs.moving_base import base_motion_from_csv, on_moving_base
    from newton_euler.runs.simulate import compile_scene, simulate
    from newton_euler.runs.variation import start, with_parameters
else:
    NAMES_OF_MODULES = {
        "analysis.identification.identify": ("Identification", "identify"),
        "analysis.identification.measurements": ("Measurements", "measurements_from_csv"),
        "analysis.kinematics.branches": ("Branches", "assembly_branches"),
        "analysis.kinematics.configurations": ("Axis",),
        "analysis.kinematics.point": ("Point",),
        "analysis.kinematics.poses": ("Poses", "solve_poses"),
        "analysis.kinematics.workspace": ("Workspace", "singular_poses", "workspace"),
        "analysis.linear.linear_model": ("LinearModel", "Modes"),
        "analysis.linear.linearization": ("linearize",),
        "analysis.linear.regulator": ("lqr",),
        "analysis.loads.envelope": ("LoadEnvelope", "LoadRange", "load_envelope"),
        "analysis.loads.equilibrium": ("equilibrium",),
        "analysis.loads.inverse_dynamics": ("Loads", "inverse_dynamics"),
        "analysis.loads.rest": ("rest_case",),
        "analysis.loads.statics": ("statics",),
        "analysis.sensitivity.sensitivities": ("Sensitivities", "sensitivities"),
        "runs.assemble": ("assemble", "initial_state"),
        "runs.batch": ("simulate_batch",),
        "runs.moving_base": ("base_motion_from_csv", "on_moving_base"),
        "runs.simulate": ("compile_scene", "simulate"),
        "runs.variation": ("start", "with_parameters"),
    }
    """Public names by module of this package, for modules that are imported at the first use of a name."""

    def __getattr__(name: str) -> Any:
        """Import a name whose module needs the equations and their compiler at its first use."""
        for module, names in NAMES_OF_MODULES.items():
            if name in names:
                return getattr(import_module(f"newton_euler.{module}"), name)
        raise AttributeError(f"module 'newton_euler' has no attribute {name!r}")

    def __dir__() -> list[str]:
        """Return all names, for completion."""
        return sorted({*globals(), *__all__})


__all__ = [
    "PD",
    "ArgumentError",
    "Armature",
    "Axis",
    "BallArmature",
    "BallSpring",
    "Body",
    "Box",
    "BranchWarning",
    "Branches",
    "Capsule",
    "Compound",
    "ComputedTorque",
    "Cylinder",
    "Cylindrical",
    "Digital",
    "ElasticGear",
    "Fixed",
    "Free",
    "Gear",
    "Identification",
    "IdentificationWarning",
    "JointFriction",
    "JointSpring",
    "JointStop",
    "LinearCoupling",
    "LinearModel",
    "LoadEnvelope",
    "LoadRange",
    "Loads",
    "Measurements",
    "Mechanism",
    "Mesh",
    "Modes",
    "Moves",
    "NearlyRedundantWarning",
    "NewtonEulerError",
    "ParallelHinges",
    "Planar",
    "Point",
    "PointOnLine",
    "PointSpring",
    "Polynomial",
    "PolynomialCoupling",
    "Poses",
    "PrescribedMotion",
    "Prismatic",
    "Revolute",
    "Rod",
    "RoundOffWarning",
    "Sampled",
    "Scene",
    "Screw",
    "Sensitivities",
    "Sine",
    "Sphere",
    "Spherical",
    "Spline",
    "State",
    "StateFeedback",
    "Steps",
    "Sum",
    "Trajectory",
    "Translational",
    "Universal",
    "WindLoad",
    "Workspace",
    "Wrench",
    "assemble",
    "assembly_branches",
    "base_motion_from_csv",
    "compile_scene",
    "equilibrium",
    "identify",
    "initial_state",
    "inverse_dynamics",
    "linearize",
    "load_envelope",
    "lqr",
    "measurements_from_csv",
    "on_moving_base",
    "rest_case",
    "sensitivities",
    "simulate",
    "simulate_batch",
    "singular_poses",
    "solve_poses",
    "start",
    "statics",
    "vertical_turbulence",
    "wind_gust",
    "wind_turbulence",
    "with_parameters",
    "workspace",
]
