"""Plots of how-to pages and tutorials, drawn from short runs of the scenes on these pages."""

from __future__ import annotations

import inspect
import re
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from page_tables import page_table
from scipy.spatial.transform import Rotation

import mjcf
import newton_euler
from crosscheck.library import load
from crosscheck.library.tracker_sun import PANEL_NORMAL, sun_tracker
from crosscheck.solar.base import Base, following_on_base
from crosscheck.solar.place import Place, day_times, sun_over
from crosscheck.support.colors import BLUE, OTHER_COLORS, VERMILION
from newton_euler import PD, Polynomial, Sine, on_moving_base

ROOT = Path(__file__).parents[2]

GRAY, ORANGE = OTHER_COLORS[3], OTHER_COLORS[1]


def side_by_side(count: int, height: float = 3.0) -> tuple[Figure, list[Axes]]:
    """Make a figure with plots in a row, each with a grid."""
    figure = Figure(figsize=(8.0, height), layout="constrained")
    axes = list(figure.subplots(1, count, squeeze=False)[0])
    for ax in axes:
        ax.grid(alpha=0.3)
    return figure, axes


def controllers() -> Figure:
    """Plot the tracking errors of four controllers of the tracker over time."""
    figure, axes = side_by_side(2)
    styles = {"computed_torque": "-", "pd": "--", "pd_gravity": ":", "lqr": "-."}
    reference = newton_euler.simulate(load("tracker_computed_torque"))  # follows its targets to round-off
    for name, style in styles.items():
        scene = load("tracker_computed_torque", controller=name)
        run = newton_euler.simulate(scene)
        for ax, slide in zip(axes, ("slide_12", "slide_13"), strict=True):
            error = run.joint(slide).coordinates[:, 0] - reference.joint(slide).coordinates[:, 0]
            ax.plot(run.time, 1e3 * error, style, label=name)
            ax.set(title=slide, xlabel="time, s", ylabel="error, mm")
    axes[0].legend(fontsize="small")
    return figure


def friction() -> Figure:
    """Plot the position of the nut of the screw lift, and the torque of its motor."""
    run = newton_euler.simulate(load(str(ROOT / "examples" / "screw_lift.yaml")))
    figure, (left, right) = side_by_side(2)
    left.plot(run.time, 1e3 * run.joint("rail").coordinates[:, 0], color=BLUE)
    left.axhline(30.0, color=GRAY, linestyle=":", label="stop")
    left.legend(fontsize="small")
    left.set(xlabel="time, s", ylabel="position of the nut, mm")
    right.plot(run.time, 1e3 * run.actuator_force[:, 0], color=VERMILION)
    right.set(xlabel="time, s", ylabel="torque of the motor, mN m")
    return figure


def identification() -> Figure:
    """Plot the residuals of the tracker's slides before and after the fit, beside the noise."""
    true = {"panel_7.mass": 0.95, "slide_12.damping": 21.0, "slide_13.stiffness": 48.0}
    fitted = {"panel_7.mass": 0.949962, "slide_12.damping": 20.9975, "slide_13.stiffness": 47.9971}
    scene, noise = load("tracker_gravity"), 1e-5
    runs = [
        newton_euler.simulate(newton_euler.with_parameters(scene, values)) for values in (true, {}, fitted)
    ]
    figure, axes = side_by_side(2)
    random = np.random.default_rng(0)
    for ax, slide in zip(axes, ("slide_12", "slide_13"), strict=True):
        measured, before, after = (1e6 * run.joint(slide).coordinates[:, 0] for run in runs)
        measured = measured + 1e6 * noise * random.normal(size=len(measured))
        ax.plot(runs[0].time, before - measured, color=VERMILION, label="before the fit")
        ax.plot(runs[0].time, after - measured, ".", color=BLUE, markersize=2, label="after the fit")
        ax.set(title=slide, xlabel="time, s", ylabel="residual, um")
        ax.set_yscale("symlog", linthresh=100.0)
    axes[0].legend(fontsize="small")
    return figure


def logs() -> Figure:
    """Plot a log of MuJoCo's run of a linkage beside the reference, and the difference."""
    path = ROOT / "examples" / "linkage.xml"
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("go").id)
    rows = []
    for _ in range(500):
        rows.append([data.time, data.qpos[0]])
        mujoco.mj_step(model, data)
    time, motor = np.array(rows).T
    reading = mjcf.read(path, key="go", duration=1.0, excitation=False)
    reference = newton_euler.simulate(replace(reading.scene, output_period=model.opt.timestep))
    exact = reference.joint("motor").coordinates[: len(time), 0]
    figure, (left, right) = side_by_side(2)
    left.plot(time, exact, color=BLUE, label="reference")
    left.plot(time, motor, "--", color=ORANGE, label="log")
    left.set(xlabel="time, s", ylabel="angle of the motor, rad")
    left.legend(fontsize="small")
    right.plot(time, np.degrees(motor - exact), color=VERMILION)
    right.set(xlabel="time, s", ylabel="error of the log, degrees")
    return figure


def modes() -> Figure:
    """Plot the eigenvalues of the tracker at rest in the complex plane, with the numbers of the modes."""
    scene = load("tracker_gravity")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", newton_euler.BranchWarning)
        modes = newton_euler.linearize(scene, newton_euler.equilibrium(scene)).modes()
    figure, (ax,) = side_by_side(1)
    for k, value in enumerate(modes.eigenvalues):
        ax.plot([value.real] * 2, [value.imag, -value.imag], "o", color=BLUE, markersize=8)
        ax.annotate(
            f" mode {k + 1}", (value.real, abs(value.imag)), xytext=(4, 6), textcoords="offset points"
        )
    ax.axvline(0.0, color="black", linewidth=0.8)
    ax.set(xlabel="real part, 1/s", ylabel="imaginary part, rad/s", xlim=(None, 3.0), ylim=(-20.0, 20.0))
    return figure


def moving_base() -> Figure:
    """Plot a slide and a reaction of the tracker, on land and in waves."""
    waves = {"roll": Sine(0.2, 2.1), "pitch": Sine(0.08, 1.3), "heave": Sine(0.1, 1.0, phase=0.5)}
    laws = [
        PD(slide, stiffness, stiffness / 10.0, target=0.0, gravity_compensation=True)
        for slide, stiffness in (("slide_12", 1000.0), ("slide_13", 280.0))
    ]
    still = replace(load("tracker_gravity"), control=tuple(laws))
    boat = on_moving_base(still, waves, point=[-0.06, 0.06, 0.0])
    figure, (left, right) = side_by_side(2)
    for scene, label, style in ((still, "on land", "--"), (boat, "in waves", "-")):
        run = newton_euler.simulate(scene)
        column = run.reaction_force[:, run.joint_names.index("universal_47")]
        left.plot(run.time, 1e3 * run.joint("slide_13").coordinates[:, 0], style, label=label)
        right.plot(run.time, np.linalg.norm(column, axis=1), style, label=label)
    left.set(xlabel="time, s", ylabel="slide_13, mm")
    right.set(xlabel="time, s", ylabel="force of the column, N")
    left.legend(fontsize="small")
    return figure


def wound_springs() -> Figure:
    """Plot the angle of the wound hinge, and the torque of its spring."""
    run = newton_euler.simulate(load(str(ROOT / "examples" / "wound_spring.yaml")))
    angle = run.joint(run.joint_names[0]).coordinates[:, 0]
    figure, (ax,) = side_by_side(1, 2.6)
    ax.plot(run.time, angle / (2.0 * np.pi), color=BLUE)
    ax.set(xlabel="time, s", ylabel="angle, revolutions")
    return figure


ROW = re.compile(
    r"^(?P<settings>[a-z]\S.*?) {2,}(?P<error>[\d.]+) +(?P<evaluations>[\d.]+) +[\d.]+$", re.MULTILINE
)
"""Row of the table of `crosscheck tune`: settings, error in %, evaluations, run time."""


def mujoco_settings() -> Figure:
    """Plot the errors of tried settings over their costs, from the table on the page."""
    page = (ROOT / "docs" / "how_to" / "mujoco_settings.md").read_text()
    figure, (ax,) = side_by_side(1, 3.4)
    for row in ROW.finditer(page):
        settings, error, cost = row["settings"], float(row["error"]), float(row["evaluations"])
        own, soft = settings.startswith("yours"), "solref" not in settings
        color = VERMILION if own else ORANGE if soft else BLUE
        ax.plot(cost, error, "s" if own else "o", color=color, markersize=7)
        step, integrator = re.findall(r'"(.*?)"', settings)[:2] if not own else ("0.002", "Euler")
        text = f"  {1e3 * float(step):g} ms, {integrator}"
        ax.annotate(text, (cost, error), fontsize="small", va="center")
    for color, label in (
        (VERMILION, "settings of the file"),
        (ORANGE, "loops of the file"),
        (BLUE, "stiffer loops"),
    ):
        ax.plot([], [], "o", color=color, label=label)
    ax.set(
        xscale="log",
        yscale="log",
        xlabel="evaluations, relative to the file",
        ylabel="error, % of the motion",
    )
    ax.set_xlim(0.05, 2.5)
    ax.axhline(0.1, color="black", linewidth=0.8, linestyle=":")
    ax.legend(fontsize="small", loc="lower left")
    return figure


def four_bar() -> Figure:
    """Plot poses of the four-bar of the tutorial, and the effect of the mistake in its file."""
    text = page_file("tutorial/four_bar.md", "my_four_bar.xml")
    figure, (left, right) = side_by_side(2, 3.2)
    runs = []
    for xml in (text, text.replace('size="0.01"', 'size="0.02"')):
        reading = mjcf.read(mujoco.MjSpec.from_string(xml), key="go", duration=2.0, excitation=False)
        runs.append(newton_euler.simulate(reading.scene))
    run = runs[0]
    for k, color in zip((0, 5, 200), (OTHER_COLORS[2], GRAY, BLUE), strict=True):
        crank, rocker = (run.joint(name).coordinates[k, 0] for name in ("motor", "pivot"))
        tip = np.array([0.1 * np.sin(crank), 0.1 * np.cos(crank)])
        wrist = np.array([0.3 + 0.25 * np.sin(rocker), 0.25 * np.cos(rocker)])
        points = np.array([[0.0, 0.0], tip, wrist, [0.3, 0.0]])
        left.plot(*points.T, "o-", color=color, linewidth=3, label=f"{run.time[k]:g} s")
    left.set(xlabel="x, m", ylabel="z, m", aspect="equal")
    left.legend(fontsize="small")
    angles = [each.joint("motor").coordinates[:, 0] for each in runs]
    right.plot(run.time, 1e3 * (angles[1] - angles[0]), color=VERMILION)
    right.set(xlabel="time, s", ylabel="error of the crank, mrad", title="with the wrong radius")
    return figure


def design() -> Figure:
    """Plot poses of the four-bar of the quickstart for designers, and the forces of its joints."""
    run = newton_euler.simulate(load(str(ROOT / "examples" / "four_bar.yaml")))
    figure, (left, right) = side_by_side(2, 3.2)
    for k, color in zip((0, 20, 43), (OTHER_COLORS[2], GRAY, BLUE), strict=True):
        crank, rocker = (run.joint(name).coordinates[k, 0] for name in ("motor", "pivot"))
        elbow = np.array([0.2 * np.sin(crank), 0.2 * np.cos(crank)])
        wrist = np.array([0.6 + 0.3 * np.sin(rocker), 0.3 * np.cos(rocker)])
        points = np.array([[0.0, 0.0], elbow, wrist, [0.6, 0.0]])
        left.plot(*points.T, "o-", color=color, linewidth=3, label=f"{run.time[k]:g} s")
    left.set(xlabel="x, m", ylabel="z, m", aspect="equal")
    left.legend(fontsize="small")
    for k, name in enumerate(run.joint_names):
        right.plot(run.time, np.linalg.norm(run.reaction_force[:, k], axis=1), label=name)
    right.set(xlabel="time, s", ylabel="force, N", ylim=(2.0, 16.0))
    right.legend(fontsize="small", loc="lower right", ncols=4)
    return figure


def page_file(page: str, name: str) -> str:
    """Return the text of a file that a page contains."""
    return (ROOT / "docs" / page).read_text().partition(f'title="{name}"\n')[2].partition("```")[0]


def explosion() -> Figure:
    """Plot the run of a servo that diverges in MuJoCo, and its reference."""
    text = page_file("how_to/own_run_explodes.md", "servo.xml")
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    rows = []
    for _ in range(6):  # MuJoCo stops the run in the next step
        mujoco.mj_step(model, data)
        rows.append([data.time, abs(data.qpos[1])])
    reading = mjcf.read(mujoco.MjSpec.from_string(text), duration=0.014, excitation=False)
    reference = newton_euler.simulate(replace(reading.scene, output_period=0.0005))
    figure, (ax,) = side_by_side(1, 2.8)
    time, angle = np.transpose(rows)
    ax.semilogy(1e3 * time, angle, "o-", color=VERMILION, label="MuJoCo, Euler, 2 ms")
    exact = np.abs(reference.joint("b").coordinates[1:, 0])
    ax.semilogy(1e3 * reference.time[1:], exact, color=BLUE, label="reference")
    ax.set(xlabel="time, ms", ylabel="angle of joint b, rad")
    ax.legend(fontsize="small", loc="upper left")
    return figure


def own_run_pinocchio() -> Figure:
    """Plot the errors of loops with Pinocchio, from the output on the page."""
    page = " ".join((ROOT / "docs" / "how_to" / "own_run_pinocchio.md").read_text().split())
    own, usual = re.findall(r"([\d.]+) % of the motion run", page)
    fixes = re.findall(r"\(([\d.e-]+) %\), (?:same|[\d.]+ times the) run time", page)
    assert len(fixes) == 2, fixes
    rows = {
        "usual settings": usual,
        "fix at the same run time": fixes[0],
        "own_run.yaml": own,
        "fix with RK4": fixes[1],
    }
    figure, (ax,) = side_by_side(1, 2.2)
    ax.barh(list(rows), [float(text) for text in rows.values()], color=[VERMILION, ORANGE, BLUE, BLUE])
    ax.set(xscale="log", xlabel="error, % of the motion")
    ax.invert_yaxis()
    return figure


def findings() -> Figure:
    """Plot the motion of an arm with a placeholder inertia, and with the inertia of a rod."""
    text = page_file("how_to/findings.md", "arm.xml")
    rod = "0.0033 0.0033 0.0002"  # kg m^2, of a rod of 0.2 m and 1 kg
    figure, axes = side_by_side(2, 2.8)
    for xml, label, style in ((text, "placeholder", "--"), (text.replace("1 1 1", rod), "rod", "-")):
        reading = mjcf.read(mujoco.MjSpec.from_string(xml), duration=2.0, excitation=True)
        run = newton_euler.simulate(reading.scene)
        for ax, joint in zip(axes, ("shoulder", "elbow"), strict=True):
            ax.plot(run.time, run.joint(joint).coordinates[:, 0], style, label=label)
            ax.set(title=joint, xlabel="time, s", ylabel="angle, rad")
    axes[0].legend(fontsize="small")
    return figure


def limits_as_forces() -> Figure:
    """Plot a block that meets its limit, in MuJoCo and as a scene with forces."""
    text = page_file("how_to/limits_as_forces.md", "block.xml")
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    rows = []
    while data.time < 0.4:
        rows.append([data.time, data.qpos[0]])
        mujoco.mj_step(model, data)
    options = {"friction": "regularized", "limits": "compliant", "duration": 0.4, "excitation": False}
    reading = mjcf.read(mujoco.MjSpec.from_string(text), key="go", **options)
    run = newton_euler.simulate(replace(reading.scene, output_period=0.001))
    figure, axes = side_by_side(2)
    for ax in axes:
        ax.plot(
            run.time, 1e3 * run.joint("rail").coordinates[:, 0], color=BLUE, label="as forces, all engines"
        )
        time, place = np.transpose(rows)
        ax.plot(time, 1e3 * place, "--", color=ORANGE, label="as constraints of MuJoCo")
        ax.axhline(200.0, color=GRAY, linestyle=":", label="limit")
        ax.set(xlabel="time, s", ylabel="position, mm")
    axes[0].legend(fontsize="small")
    axes[1].set(xlim=(0.195, 0.24), ylim=(194.0, 209.0), title="at the limit")
    return figure


def identification_friction() -> Figure:
    """Plot the effect of dry friction on a slide of the tracker, and the rate of the slide."""
    bare = load("tracker_gravity")
    slides = ("slide_12", "slide_13")
    dry = [newton_euler.JointFriction(slide, 0.3) for slide in slides]
    runs = [newton_euler.simulate(scene) for scene in (bare, replace(bare, forces=(*bare.forces, *dry)))]
    figure, axes = side_by_side(2)
    for ax, slide in zip(axes, slides, strict=True):
        without, with_friction = (1e3 * run.joint(slide).coordinates[:, 0] for run in runs)
        ax.plot(runs[0].time, without, "--", color=GRAY, label="without friction")
        ax.plot(runs[0].time, with_friction, color=BLUE, label="with 0.3 N")
        ax.set(title=slide, xlabel="time, s", ylabel="coordinate, mm")
    axes[0].legend(fontsize="small")
    return figure


def wind() -> Figure:
    """Plot forces of the tracker's sliders over the wind speed, and the coefficients of a square plate."""
    figure, (left, right) = side_by_side(2)
    forces = page_table("../how_to/wind.md", "wind speed, m/s")
    speeds, *sliders = np.array([[float(text) for text in row] for row in forces.rows]).T
    for slide, force, color in zip(("slide_12", "slide_13"), sliders, (BLUE, VERMILION), strict=True):
        left.plot(speeds, force, "o-", color=color, label=slide)
    left.set(xlabel="wind speed, m/s", ylabel="holding force, N")
    table = page_table("../how_to/wind.md", "angle of attack, degrees")
    angles = [float(text) for text in table.heads[1:]]
    for row, color in zip(table.rows, (BLUE, VERMILION), strict=True):
        right.plot(angles, [float(text) for text in row[1:]], "o-", color=color, label=row[0])
    right.set(xlabel="angle of attack, degrees", ylabel="coefficient")
    for ax in (left, right):
        ax.legend(fontsize="small")
    return figure


def loads_by_hand() -> Figure:
    """Draw the linkage with a panel in the wind, and the forces on the rocker and on the coupler."""
    ground, elbow, wrist, pivot = np.array([[0.0, 0.0], [0.0, 0.1], [0.3, 0.25], [0.3, 0.0]])
    figure = Figure(figsize=(8.0, 5.0), layout="constrained")
    ax = figure.add_subplot()
    ax.plot([0.3, 0.3], [-0.05, 0.45], color=OTHER_COLORS[2], linewidth=9, alpha=0.5)  # the panel, 0.5 m
    ax.plot(*np.transpose([ground, elbow, wrist, pivot]), "o-", color=GRAY, linewidth=4, markersize=8)
    parts = {"crank": (0.01, 0.02), "coupler": (0.1, 0.185), "rocker": (0.31, 0.06), "panel": (0.31, 0.42)}
    for name, place in parts.items():
        ax.text(*place, name)
    # forces, N: their place, their components, and the place of the label
    forces = {
        "wind 17.9 N": ((0.3, 0.2), (17.888, 0.0), (0.41, 0.205)),
        "coupler on rocker 16.7 N": (wrist, (-14.310, -8.627), (0.05, 0.26)),
        "weight 2.9 N": ((elbow + wrist) / 2, (0.0, -2.943), (0.13, 0.135)),
        "crank on coupler 15.4 N": (elbow, (-14.310, -5.684), (-0.17, 0.045)),
        "ground on rocker 28.5 N": (pivot, (-3.578, 28.247), (0.09, 0.1)),
    }
    for label, (place, force, text) in forces.items():
        end = np.add(place, 0.006 * np.array(force))
        ax.annotate("", end, place, arrowprops={"arrowstyle": "->", "color": VERMILION, "linewidth": 2})
        ax.text(*text, label, fontsize="small", color=VERMILION)
    ax.set(xlabel="x, m", ylabel="z, m", aspect="equal", xlim=(-0.2, 0.55), ylim=(-0.08, 0.48))
    return figure


def load_cases() -> Figure:
    """Plot the peak forces of joints in three cases, from the output on the page."""
    page = (ROOT / "docs" / "how_to" / "load_cases.md").read_text()
    head, _, *rows = page.partition("Peak force of every case\n")[2].partition("...")[0].splitlines()
    cases = head.split()[2:]
    figure, (ax,) = side_by_side(1, 3.0)
    for k, (case, color) in enumerate(zip(cases, (GRAY, ORANGE, BLUE), strict=True)):
        values = [float(row.split()[1 + k].strip("*")) for row in rows]
        ax.bar(np.arange(len(rows)) + 0.27 * (k - 1), values, 0.27, color=color, label=case)
    ax.set_xticks(range(len(rows)), [row.split()[0] for row in rows], fontsize="small")
    ax.set(ylabel="peak force, N")
    ax.legend(fontsize="small")
    return figure


def logs_examples() -> Figure:
    """Plot the error of Drake's log over the time step, from the table on the page."""
    table = page_table("../how_to/logs_examples.md", "time step of Drake, ms")
    steps, errors = ([float(text) for text in row[1:]] for row in (table.heads, table.rows[0]))
    figure, (ax,) = side_by_side(1, 2.6)
    ax.loglog(steps, errors, "o-", color=BLUE)
    ax.set_xticks(steps, [f"{step:g}" for step in steps])
    ax.set_yticks(errors, [f"{error:g}" for error in errors])
    ax.minorticks_off()
    ax.set(xlabel="time step of Drake, ms", ylabel="error, um")
    return figure


def assembly_branches() -> Figure:
    """Draw the assembly branches of the four-bar with the same angle of its motor."""
    scene = load(str(ROOT / "examples" / "four_bar.yaml"))
    branches = newton_euler.assembly_branches(scene, {"motor": 0.3})
    tips = {"crank": [0.0, 0.0, 0.2], "rocker": [0.6, 0.1, 0.3]}  # of the mechanism as drawn, m
    elbow, wrist = (
        branches.poses.positions(newton_euler.Point(body, tip))[:, ::2] for body, tip in tips.items()
    )
    figure, (ax,) = side_by_side(1, 3.6)
    for k, color, style in (
        (0, BLUE, "o-"),
        (2, VERMILION, "o--"),
    ):  # 1 and 3 differ by a turn of the coupler
        points = [[0.0, 0.0], elbow[k], wrist[k], [0.6, 0.0]]
        label = f"branch {k}"
        ax.plot(*np.transpose(points), style, color=color, linewidth=3, label=label)
    ax.set(xlabel="x, m", ylabel="z, m", aspect="equal")
    ax.legend(fontsize="small", loc="center left", bbox_to_anchor=(1.0, 0.5))
    return figure


def sun_on_ship() -> Figure:
    """Plot the sliders of a tracker on a ship, and its pointing errors with compensation and without."""
    sun = sun_over(Place(11.56, 104.92), day_times("2026-03-21", "UTC+07:00", 3600.0))
    towards, period, count = sun.direction[12], 0.25, 81
    ship = Base({"roll": Sine(0.1, 2.0 * np.pi / 8.0), "yaw": Polynomial((0.0, 0.01))})
    wanted = {
        "with compensation": (np.tile(towards, (count, 1)), BLUE, "-"),
        "without": (ship.rotations(period * np.arange(count)) @ towards, VERMILION, "--"),
    }
    figure, (left, right) = side_by_side(2)
    for label, (directions, color, style) in wanted.items():
        scene, _ = following_on_base(sun_tracker(), PANEL_NORMAL, directions, ship, period)
        run = newton_euler.simulate(scene)
        turns = Rotation.from_quat(run.quaternion[:, run.body_names.index("panel_7")], scalar_first=True)
        error = np.arccos(np.clip(turns.apply(PANEL_NORMAL.axis) @ towards, -1.0, 1.0))
        right.plot(run.time, np.degrees(error), style, color=color, label=label)
        if label == "with compensation":
            for slide in ("slide_12", "slide_13"):
                left.plot(run.time, 1e3 * run.joint(slide).coordinates[:, 0], label=slide)
    left.set(xlabel="time, s", ylabel="position, mm")
    right.set(xlabel="time, s", ylabel="pointing error, degrees")
    for ax in (left, right):
        ax.legend(fontsize="small")
    return figure


GAIN = re.compile(
    r"^(\d+(?:\.\d+)?) N, 0 E +2026-(\d\d)-\d\d +\S+ +\S+ +\S+ +(\S+) +(\S+) +(\S+) +\S+$", re.MULTILINE
)
"""Row of the table of `crosscheck sun` with several places: latitude, month and three gains, %."""


def sun_gain() -> Figure:
    """Plot the gains of a tracker, of one axis and of a panel that faces the sun, by latitude and season."""
    rows = GAIN.findall((ROOT / "docs" / "how_to" / "sun_gain.md").read_text())
    latitudes = list(dict.fromkeys(row[0] for row in rows))
    figure, axes = side_by_side(len(latitudes))
    styles = {"this tracker": BLUE, "one axis": ORANGE, "facing the sun": GRAY}
    months = {"03": "March", "06": "June", "09": "Sept.", "12": "Dec."}
    for ax, latitude in zip(axes, latitudes, strict=True):
        found = [row for row in rows if row[0] == latitude]
        places = np.arange(len(found))
        for k, (label, color) in enumerate(styles.items()):
            gains = [float(row[2 + k]) for row in found]
            ax.bar(places + 0.27 * (k - 1), gains, 0.27, color=color, label=label)
        ax.set_xticks(places, [months[row[1]] for row in found])
        ax.axhline(0.0, color="black", linewidth=0.8)
        ax.set(title=f"latitude {latitude} N", ylim=(-55.0, 75.0))
    axes[0].set_ylabel("gain over a fixed panel, %")
    axes[0].legend(fontsize="small", loc="lower left")
    return figure


GUIDE_PLOTS: dict[str, Callable[[], Figure]] = {
    "plot_controllers": controllers,
    "plot_friction": friction,
    "plot_identification": identification,
    "plot_logs": logs,
    "plot_modes": modes,
    "plot_moving_base": moving_base,
    "plot_mujoco_settings": mujoco_settings,
    "plot_four_bar": four_bar,
    "plot_wound_springs": wound_springs,
    "plot_explosion": explosion,
    "plot_own_run_pinocchio": own_run_pinocchio,
    "plot_design": design,
    "plot_findings": findings,
    "plot_limits_as_forces": limits_as_forces,
    "plot_identification_friction": identification_friction,
    "plot_wind": wind,
    "plot_loads_by_hand": loads_by_hand,
    "plot_sun_gain": sun_gain,
    "plot_load_cases": load_cases,
    "plot_logs_examples": logs_examples,
    "plot_assembly_branches": assembly_branches,
    "plot_sun_on_ship": sun_on_ship,
}
"""Functions that draw plots, by the name of the picture."""


BLOCK = re.compile(r"^```.*?^```$|^\|.*$", re.MULTILINE | re.DOTALL)
"""A block of code or a row of a table."""


def guide_content(name: str) -> str:
    """What a plot is made from: the code that draws it, and blocks and tables of the pages that it names."""
    source = inspect.getsource(GUIDE_PLOTS[name])
    pages = [next((ROOT / "docs").glob(f"*/{page}")) for page in re.findall(r"\w+\.md", source)]
    return "\n".join([source, *(block for page in pages for block in BLOCK.findall(page.read_text()))])
