"""Repeat a file's own run with MuJoCo alone, and measure its error and the error of each remedy.

    python engine_alone.py robot.xml output/robot/summary.json

`crosscheck run robot.xml` writes summary.json. The script takes start, controls and settings from its entry
`own_run`, and nothing else of crosscheck. The reference is a run in MuJoCo too, with the file's time step
divided by 50, RK4 (implicit if RK4 diverges) and nearly rigid constraints. The script prints one line of
JSON for the run of the file and one for each remedy: the largest errors of a center of mass, m, and of an
orientation, rad; null for a run that diverges.
"""

import json
import sys
from collections.abc import Mapping, Sequence
from typing import Any

import mujoco
import numpy as np

FINE_STEP_DIVISOR = 50
"""Factor by which the time step of the reference is shorter than that of the file."""


DIVERGENCE = (
    mujoco.mjtWarning.mjWARN_BADQPOS,
    mujoco.mjtWarning.mjWARN_BADQVEL,
    mujoco.mjtWarning.mjWARN_BADQACC,
)
"""Warnings after which MuJoCo resets a run."""


def simulate(
    model: Any, inputs: Mapping[str, Any], times: Sequence[float]
) -> tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]] | None:
    """Simulate a compiled model: return centers of mass (n, b, 3), m, and orientations (n, b, 4).

    Bodies without a joint between them count as one. The result is None for a run that diverges.

    Args:
        model: compiled model.
        inputs: start and controls.
        times: (n,) output times, s.
    """
    data = mujoco.MjData(model)
    for name in ("qpos", "qvel", "act", "eq_active"):
        getattr(data, name)[:] = inputs[name]
    constant, sine, cosine, frequency = map(np.array, inputs["ctrl"].values())
    groups = list(inputs["bodies"].values())  # bodies that are fixed to each other, the root first
    bodies = [root for root, *_ in groups]
    weights = np.array([np.isin(np.arange(model.nbody), group) * model.body_mass for group in groups])
    weights /= weights.sum(axis=1, keepdims=True)
    centers, orientations = [], []
    for k, now in enumerate(times):
        for _ in range(round((now - times[k - 1]) / model.opt.timestep) if k else 0):
            phase = frequency * (data.time + 0.5 * model.opt.timestep)  # controls of the middle of the step
            data.ctrl[:] = constant + sine * np.sin(phase) + cosine * np.cos(phase)
            mujoco.mj_step(model, data)
        if any(data.warning[kind].number for kind in DIVERGENCE):
            return None
        mujoco.mj_kinematics(model, data)
        centers.append(weights @ data.xipos)
        orientations.append(data.xquat[bodies])
    return np.array(centers), np.array(orientations)


def compiled(path: str, inputs: Mapping[str, Any], settings: Mapping[str, str]) -> Any:
    """Compile a file, switch off what the judged run leaves out, and apply settings.

    Args:
        path: path of the MJCF file.
        inputs: start and controls of the judged run, and "model", the arrays that the run changes.
        settings: attributes of MJCF by name, such as {"timestep": "0.001", "solref": "0.002 1"}.
    """
    model = mujoco.MjModel.from_xml_path(path)
    for name, value in inputs["model"].items():
        owner = model.opt if name.startswith("opt.") else model
        array = np.asarray(value)
        if array.ndim:
            getattr(owner, name.removeprefix("opt."))[:] = array
        else:
            setattr(owner, name.removeprefix("opt."), value)
    for name, text in settings.items():
        match name:
            case "integrator":
                model.opt.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{text.upper()}")
            case "solver":
                model.opt.solver = getattr(mujoco.mjtSolver, f"mjSOL_{text.upper()}")
            case "solref":
                model.eq_solref[:] = [float(number) for number in text.split()]
            case "solimp":
                model.eq_solimp[:, :3] = [float(number) for number in text.split()]
            case "iterations":
                model.opt.iterations = int(text)
            case _:  # timestep or tolerance
                setattr(model.opt, name, float(text))
    return model


def main(path: str, summary: str) -> None:
    """Print the errors of the judged run and of its remedies."""
    with open(summary, encoding="utf-8") as file:
        own_run = json.load(file)["own_run"]
    if own_run["without"] and own_run["band"] == "NOT JUDGED":
        own_run = own_run["without"]  # the run without elements that act from the start on
    inputs, until = own_run["run_inputs"], own_run["until"]
    # `until` is the time at which the comparison ends; that of a chaotic mechanism may end earlier
    times = [now for now in inputs["output_times"] if until is None or now < until]
    mechanisms = own_run["scale"]["mechanisms"]
    ends = {body: each["until"] for each in mechanisms for body in each["bodies"]}
    compared = np.array(
        [[ends[body] is None or now < ends[body] for body in inputs["bodies"]] for now in times]
    )
    step = compiled(path, inputs, {}).opt.timestep / FINE_STEP_DIVISOR
    stiff = {"solref": f"{2.0 * step} 1", "solimp": "0.9999 0.9999 0.001", "solver": "Newton"}
    fine = {"timestep": f"{step}", "iterations": "100", "tolerance": "1e-12", **stiff}
    reference = None
    for integrator in ("RK4", "implicit"):  # RK4 diverges on very stiff dampers
        if reference is None:
            reference = simulate(compiled(path, inputs, fine | {"integrator": integrator}), inputs, times)
    for settings in ({}, *(remedy["changes"] for remedy in own_run["remedies"])):
        run = simulate(compiled(path, inputs, settings), inputs, times)
        print(json.dumps(None if run is None or reference is None else errors(run, reference, compared)))


def errors(run: Any, reference: Any, compared: Any) -> dict[str, float]:
    """Return the largest distance of centers of mass, m, and angle between orientations, rad, of two runs.

    Args:
        run, reference: centers of mass (n, b, 3) and orientations (n, b, 4).
        compared: (n, b) False where a chaotic body is not compared.
    """
    (centers, orientations), (others, other_orientations) = run, reference
    position = np.max(compared * np.linalg.norm(centers - others, axis=2))
    # unit quaternions with a chord c between them differ by the angle 4 asin(c / 2); q and -q are one turn
    chords = [np.linalg.norm(orientations - sign * other_orientations, axis=2) for sign in (1.0, -1.0)]
    angle = np.max(4.0 * compared * np.arcsin(0.5 * np.minimum(*chords)))
    return {"position": float(position), "rotation": float(angle)}


if __name__ == "__main__":
    main(*sys.argv[1:])
