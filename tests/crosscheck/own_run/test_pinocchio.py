"""The run of a URDF or a Pinocchio model in a user's loop: known errors, causes, and the plain loop."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
import yaml
from scipy.integrate import solve_ivp

import crosscheck
from crosscheck.library import load
from crosscheck.loading.load import load_scene, with_excitation
from crosscheck.own_run.errors import Band
from crosscheck.own_run.judge import judge
from crosscheck.report.own_run import own_run_lines
from newton_euler.errors import NewtonEulerError
from newton_euler.reading.file_run import Event
from urdf.file_run import closing_gains
from urdf.run_settings import EXPLICIT, RK4, SEMI_IMPLICIT
from urdf.write import to_loops, to_urdf

STEP, DURATION, GRAVITY = 0.004, 1.0, 9.81
PERCENT = 0.01
"""Largest difference between the reported and the known error, relative."""

LINK = """<robot name="model"><link name="ground"/><link name="body"><inertial><origin xyz="{arm} 0 0"/>
  <mass value="2"/><inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="joint" type="{kind}"><parent link="ground"/><child link="body"/><axis xyz="{axis}"/>
  <limit lower="-100" upper="100" effort="1000" velocity="1000"/><dynamics damping="{damping}"/></joint>
  </robot>"""


def judged(path, options=(), excited=False):
    options = {"duration": str(DURATION), **dict(options)}
    _, report = load_scene(str(path), with_excitation(str(path), options) if excited else options)
    assert report is not None
    assert report.simulation is not None
    return judge(report.simulation)


def test_a_loop_without_limits_is_judged_to_the_end(tmp_path):
    """Neither the loop nor the reference has the limit, so that both are the same model also after it."""
    text = LINK.format(arm=0.3, kind="revolute", axis="0 1 0", damping=0.1).replace('"-100"', '"-0.05"')
    event = Event(0.1, "limits of joint 'joint'")
    _, report = load_scene(str(written(tmp_path, text)), {"duration": str(DURATION)})
    found = judge(report.simulation, [event])
    assert (found.events, found.until, found.without) == ((event,), None, None)
    assert found.error == judged(written(tmp_path, text)).error
    note, _ = (line for line in own_run_lines(found)[0].lines if line.startswith("  note"))
    assert note.endswith("nor does your loop")


def written(tmp_path, text):
    path = tmp_path / "model.urdf"
    path.write_text(text)
    return path


def loop_settings(integrator, step=STEP, **others):
    return {"own_run": str({"timestep": step, "integrator": integrator, **others})}


@pytest.mark.parametrize(
    ("integrator", "sign"), [(SEMI_IMPLICIT, 1.0), (EXPLICIT, -1.0)], ids=["semi-implicit", "explicit"]
)
def test_error_of_a_fall(tmp_path, integrator, sign):
    # after n steps the stone has fallen by g h^2 n (n +- 1) / 2 instead of g (n h)^2 / 2
    path = written(tmp_path, LINK.format(kind="prismatic", axis="0 0 1", arm=0, damping=0))
    found = judged(path, loop_settings(integrator))
    assert sign * found.error.position == pytest.approx(
        sign * 0.5 * GRAVITY * STEP * found.reference.time[-1], rel=PERCENT
    )
    assert found.error.position_at[0] == "body"


@pytest.mark.parametrize(
    ("integrator", "damping"),
    [(SEMI_IMPLICIT, "explicit"), (SEMI_IMPLICIT, "implicit"), (EXPLICIT, "explicit"), (RK4, "explicit")],
)
def test_error_of_a_damped_fall(tmp_path, integrator, damping):
    # dv/dt = -g - k v with k = d / m: every method multiplies the difference to the final speed by a factor
    path = written(tmp_path, LINK.format(kind="prismatic", axis="0 0 1", arm=0, damping=6))
    step = 0.02
    found = judged(path, loop_settings(integrator, step, damping=damping))
    rate, final = 6.0 / 2.0, -GRAVITY / (6.0 / 2.0)
    z = -rate * step
    factor = 1.0 + z if integrator != RK4 else 1.0 + z + z**2 / 2.0 + z**3 / 6.0 + z**4 / 24.0
    if damping == "implicit":
        factor = 1.0 / (1.0 - z)
    steps = np.round(found.reference.time / step)
    # positions: sums of new velocities, of old velocities, or the same series as a whole
    speed = final * (1.0 - factor**steps)
    if integrator == RK4:
        position = final * steps * step - final * (1.0 - factor**steps) / rate
    else:
        geometric = (1.0 - factor**steps) / (1.0 - factor)
        position = step * final * (steps - geometric * (factor if integrator == SEMI_IMPLICIT else 1.0))
    time = found.reference.time
    exact = final * time - final * (1.0 - np.exp(-rate * time)) / rate
    assert np.all(np.diff(speed) < 0.0)
    assert found.error.position == pytest.approx(np.max(np.abs(position - exact)), rel=PERCENT)


def test_error_of_a_pendulum(tmp_path):
    # angle from the horizontal; moment of inertia about the joint 0.1 + 2 0.5^2 kg m^2
    path = written(tmp_path, LINK.format(kind="revolute", axis="0 1 0", arm=0.5, damping=0))
    found = judged(path, loop_settings(SEMI_IMPLICIT))
    stiffness = 2.0 * GRAVITY * 0.5 / (0.1 + 2.0 * 0.5**2)
    time = found.reference.time
    exact = solve_ivp(
        lambda _, x: [x[1], stiffness * np.cos(x[0])],
        (0.0, time[-1]),
        [0.0, 0.0],
        t_eval=time,
        rtol=1e-11,
        atol=1e-12,
    ).y[0]
    angle = speed = 0.0
    angles = [angle]
    for _ in range(round(time[-1] / STEP)):
        speed += STEP * stiffness * np.cos(angle)
        angle += STEP * speed
        angles.append(angle)
    at_outputs = np.array(angles)[:: round(time[1] / STEP)]
    assert found.error.rotation == pytest.approx(np.max(np.abs(at_outputs - exact)), rel=PERCENT)


def test_cause_explicit_damping(tmp_path):
    """A damper that is faster than the step makes the run diverge; implicit damping brings the run back."""
    path = written(tmp_path, LINK.format(kind="revolute", axis="0 1 0", arm=0.5, damping=200))
    found = judged(path, loop_settings(SEMI_IMPLICIT, 0.01))
    assert found.stopped
    assert found.causes[0].name == "explicit damping"
    assert found.remedies[0].changes == {"damping": "implicit"}
    assert found.remedies[0].error.relative < 0.1


ROTOR = """<transmission name="drive"><type>transmission_interface/SimpleTransmission</type>
  <joint name="joint"/><actuator name="motor"><drake:rotor_inertia value="0.01"/><drake:gear_ratio value="9"/>
  </actuator></transmission></robot>"""


def test_what_a_loop_with_pinocchios_reader_lacks(tmp_path):
    """A rotor of 0.01 9^2 kg m^2 and the damper act in the judged loop, and not with the plain reader."""
    text = LINK.format(arm=0.5, kind="revolute", axis="0 1 0", damping=0.2)
    text = text.replace("<robot ", '<robot xmlns:drake="http://drake.mit.edu" ').replace("</robot>", ROTOR)
    found = judged(written(tmp_path, text), loop_settings(RK4, 0.001))
    assert [need.elements for need in found.needs] == [
        ("rotor of joint 'joint'",),
        ("damping of joint 'joint'",),
    ]
    assert "to 0.81" in found.needs[0].remedy
    notes = [line for line in own_run_lines(found)[0].lines if line.startswith("  note")]
    assert len(notes) == 2

    def last_position(armature, damping):
        """Simulate the reader's model with semi-implicit steps that are too small to matter."""
        model = pin.buildModelFromXML(text)
        model.armature = np.full(1, armature)
        data, q, v, step = model.createData(), pin.neutral(model), np.zeros(1), 1e-4
        for _ in range(round(found.reference.time[-1] / step)):
            v = v + step * pin.aba(model, data, q, v, -damping * v)
            q = pin.integrate(model, q, step * v)
        pin.forwardKinematics(model, data, q)
        return data.oMi[1].act(model.inertias[1].lever)

    # the steps' error is below 1 mm; without either element the body is centimeters elsewhere
    end = found.reference.position[-1, found.reference.body_names.index("body")]
    assert np.linalg.norm(last_position(0.81, 0.2) - end) < 1e-3
    assert np.linalg.norm(last_position(0.0, 0.2) - end) > 0.01
    assert np.linalg.norm(last_position(0.81, 0.0) - end) > 0.01


def test_a_model_in_memory_has_its_own_rotors():
    model = pin.Model()
    model.addJoint(0, pin.JointModelRY(), pin.SE3.Identity(), "joint")
    model.appendBodyToJoint(
        1, pin.Inertia.FromBox(1.0, 0.5, 0.1, 0.1), pin.SE3(np.eye(3), np.array([0.5, 0, 0]))
    )
    model.armature = np.full(1, 0.1)
    _, report = load_scene(model, {"duration": "0.2"})
    assert judge(report.simulation).needs == ()


def four_bar(tmp_path):
    scene = load("slider_crank")
    path, loops = tmp_path / "crank.urdf", tmp_path / "crank.loops.yaml"
    path.write_text(to_urdf(scene))
    loops.write_text(to_loops(scene))
    return path, {"loops": str(loops)}


CLOSED = {"kp": 10.0, "kd": 6.3}
CAUSES = {
    "step of a crank": (loop_settings(SEMI_IMPLICIT, 0.01, kp=1e4, kd=100), "time step"),
    "step of RK4": (loop_settings(RK4, 0.03, kp=40, kd=12), "time step"),
    "no gains": (loop_settings(SEMI_IMPLICIT, 0.002, kp=0, kd=0), "Baumgarte stabilization"),
    "unstable gains": (loop_settings(SEMI_IMPLICIT, 0.002, kp=1e6, kd=2000), "Baumgarte stabilization"),
    "large mu": (loop_settings(RK4, 0.002, mu=0.3, iterations=1, **CLOSED), "proximal iterations"),
    "explicit Euler": (loop_settings(EXPLICIT, 0.0005, kp=4e6, kd=4000), "integrator"),
}


@pytest.mark.parametrize("name", CAUSES)
def test_cause(tmp_path, name):
    options, cause = CAUSES[name]
    path, loops = four_bar(tmp_path)
    found = judged(path, options | loops, excited=True)
    assert found.band is not Band.ACCURATE
    assert found.causes[0].name == cause, [(each.name, each.error.relative) for each in found.causes]
    assert found.remedies
    assert all(each.error.relative < found.error.relative for each in found.remedies)


@pytest.mark.parametrize("integrator", [SEMI_IMPLICIT, EXPLICIT, RK4])
@pytest.mark.parametrize("factor", [1.0, 0.1])
def test_gains_close_loops(integrator, factor):
    """All errors of the linear closure decay, and the two Euler methods remove them at factor 1."""
    step = 0.01
    kp, kd = closing_gains(step, integrator, factor)
    matrix = np.array([[0.0, 1.0], [-kp, -kd]])
    if integrator == SEMI_IMPLICIT:
        new_rate = np.array([[-step * kp, 1.0 - step * kd]])
        grown = np.vstack([np.array([[1.0, 0.0]]) + step * new_rate, new_rate])
    elif integrator == EXPLICIT:
        grown = np.eye(2) + step * matrix
    else:
        powers = [np.linalg.matrix_power(step * matrix, k) for k in range(5)]
        grown = sum(power / [1.0, 1.0, 2.0, 6.0, 24.0][k] for k, power in enumerate(powers))
    largest = max(abs(np.linalg.eigvals(grown)))
    assert largest < 1.0
    if integrator != RK4 and factor == 1.0:
        assert largest < 1e-6


def crank_and_constraint():
    """Three bars from the ground to the ground, as a model in memory, with a configuration."""
    model, bar = pin.Model(), pin.Inertia.FromBox(5.0, 0.6, 0.01, 0.1)
    half, end = (pin.SE3(np.eye(3), np.array([x, 0.0, 0.0])) for x in (0.3, 0.6))
    parent, placement = 0, pin.SE3.Identity()
    for name in ("a", "b", "c"):
        parent = model.addJoint(parent, pin.JointModelRY(), placement, name)
        model.appendBodyToJoint(parent, bar, half)
        placement = end
    q = np.array([-1.2, 1.3, 0.9])
    data = model.createData()
    pin.forwardKinematics(model, data, q)
    ends = parent, end, 0, data.oMi[parent] * end
    constraint = pin.RigidConstraintModel(pin.ContactType.CONTACT_3D, model, *ends, pin.LOCAL)
    return model, constraint, q


@pytest.mark.parametrize("step", [0.005, 0.0025])
def test_the_plain_loop(step):
    """The judged run is the loop of Pinocchio's example, to the last digits."""
    model, constraint, q = crank_and_constraint()
    constraint.setBaumgarteCorrectorParameters(pin.BaumgarteCorrectorParameters(100.0, 20.0))
    options = {"q": ",".join(map(str, q)), "own_run": f"{{timestep: {step}}}", "duration": "0.5"}
    _, report = load_scene((model, [constraint]), options)
    found = judge(report.simulation)
    # the loop, with plain Pinocchio
    data, v = model.createData(), np.zeros(model.nv)
    datas = [constraint.createData()]
    pin.initConstraintDynamics(model, data, [constraint], datas)
    proximal = pin.ProximalSettings(1e-8, 1e-10, 10)
    for _ in range(round(found.run.time[-1] / step)):
        a = pin.constraintDynamics(model, data, q, v, np.zeros(3), [constraint], datas, proximal)
        v = v + a * step
        q = pin.integrate(model, q, v * step)
    pin.forwardKinematics(model, data, q)
    for body, joint in zip(found.run.body_names[1:], (1, 2, 3), strict=True):
        center = data.oMi[joint].act(model.inertias[joint].lever)
        assert found.run.position[-1, found.run.body_names.index(body)] == pytest.approx(center, abs=1e-9)
    closest = found.reference.position[-1, -1]
    assert found.error.position >= np.linalg.norm(center - closest) * (1.0 - 1e-6)


def test_gains_of_constraints_in_memory():
    """Constraints without gains drift; the remedy has gains, and its fragment is a file of settings."""
    model, constraint, q = crank_and_constraint()
    options = {"q": ",".join(map(str, q))}
    _, report = load_scene((model, [constraint]), options)
    found = judge(report.simulation)
    assert "kp 0, kd 0" in found.settings
    assert found.causes[0].name == "Baumgarte stabilization"
    best = found.remedies[-1]
    pasted = yaml.safe_load(best.fragment)
    _, again = load_scene((model, [constraint]), options | {"own_run": str(pasted)})
    assert judge(again.simulation).error.relative == pytest.approx(best.error.relative, rel=1e-3)


def test_settings_for_an_error_of_a_model_in_memory():
    """The found settings reach the error if they are given as options."""
    model, constraint, q = crank_and_constraint()
    arguments = {"error": 1e-2, "q": q, "duration": 0.5}
    tuning = crosscheck.tune((model, [constraint]), **arguments)
    assert tuning.found.error.relative <= 1e-2 < tuning.own.error.relative
    own_run = yaml.safe_load(tuning.found.fragment)
    again = crosscheck.tune((model, [constraint]), own_run=own_run, **arguments)
    # at other times, as the outputs are at multiples of the time step
    assert again.own.error.relative == pytest.approx(tuning.found.error.relative, rel=0.1)


MIMIC = """<robot name="gripper"><link name="palm"/>
  {fingers}</robot>"""
FINGER = """<link name="{name}"><inertial><origin xyz="0.05 0 0"/><mass value="0.1"/>
  <inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="{name}_joint" type="revolute"><origin xyz="0 {y} 0"/><parent link="palm"/>
  <child link="{name}"/><axis xyz="0 1 0"/>
  <limit lower="-9" upper="9" effort="9" velocity="99"/>{mimic}</joint>"""


@pytest.mark.slow
def test_mimics(tmp_path):
    """Two fingers that move alike fall like one: the error is the one of a single pendulum."""
    mimic = '<mimic joint="one_joint" multiplier="1" offset="0"/>'
    one = FINGER.format(name="one", y=0, mimic="")
    two = FINGER.format(name="two", y=0.1, mimic=mimic)
    options = loop_settings(SEMI_IMPLICIT)
    both = judged(written(tmp_path, MIMIC.format(fingers=one + two)), options)
    alone = judged(written(tmp_path, MIMIC.format(fingers=one)), options)
    assert both.error.rotation == pytest.approx(alone.error.rotation, rel=1e-6)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{timstep: 1}", "own_run: unknown key 'timstep'; did you mean 'timestep'"),
        ("{timestep: 0}", "own_run: timestep is '0'; needed: a number of seconds above 0"),
        ("{integrator: Euler}", "own_run: unknown integrator 'Euler'"),
        ("{integrator: RK4, damping: implicit}", "own_run: damping of integrator RK4 is implicit"),
        ("{kp: -1}", "own_run: kp is '-1'; needed: a number, 0 or more"),
        ("{iterations: 2.5}", "own_run: iterations is '2.5'; needed: a whole number"),
        ("{[1]: 2}", "own_run: not YAML"),
        ("nowhere.yaml", "nowhere.yaml: cannot be read"),
    ],
)
def test_invalid_settings(tmp_path, text, message):
    path = written(tmp_path, LINK.format(kind="revolute", axis="0 1 0", arm=0.5, damping=0))
    with pytest.raises(NewtonEulerError, match="^" + message.replace("[", r"\[")):
        load_scene(str(path), {"own_run": text})


def test_run_inputs_have_the_start_that_crosscheck_adds(tmp_path):
    text = LINK.format(kind="revolute", axis="0 1 0", arm=0.5, damping=0)
    found = judged(written(tmp_path, text), loop_settings(RK4), excited=True)
    model, step = pin.buildModelFromXML(text), 1e-4  # too small to matter

    def end(v):
        """Simulate from the recorded q with semi-implicit steps, and return the body's center."""
        data, q = model.createData(), np.array(found.run_inputs["q"])
        for _ in range(round(found.reference.time[-1] / step)):
            v = v + step * pin.aba(model, data, q, v, np.zeros(1))
            q = pin.integrate(model, q, step * v)
        pin.forwardKinematics(model, data, q)
        return data.oMi[1].act(model.inertias[1].lever)

    center = found.reference.position[-1, found.reference.body_names.index("body")]
    assert np.linalg.norm(end(np.array(found.run_inputs["v"])) - center) < 1e-3
    assert np.linalg.norm(end(np.zeros(1)) - center) > 0.01


def test_a_run_that_has_left_the_motion_has_no_sum_of_causes(tmp_path):
    """Explicit Euler adds energy to a pendulum until it turns over."""
    path = written(tmp_path, LINK.format(kind="revolute", axis="0 1 0", arm=0.5, damping=0))
    found = judged(path, {**loop_settings(EXPLICIT, 0.05), "duration": "5"})
    assert found.error.relative > 1.0
    lines = own_run_lines(found)[0].lines
    cause = next(number for number, line in enumerate(lines) if line.startswith("  cause"))
    assert "judge a shorter duration" in lines[cause + 1]
