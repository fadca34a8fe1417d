"""MJCF that is refused: includes, assets, names, numbers, options."""

from __future__ import annotations

import random
from collections.abc import Iterator

from hostile_files import (
    LAUGHS,
    MJCF,
    SEED,
    WEDGE,
    Case,
    Prepare,
    chain_of_includes,
    edited,
    fifo,
    file_of,
    link_to,
    sparse,
    with_options,
)

WORLD = "<worldbody>"

MESH = '<mesh name="wedge" file="wedge.obj"/>'

Edit = tuple[str, str, str] | tuple[str, str, str, Prepare]


def include(file: str, message: str, *prepare: Prepare) -> Edit:
    return (WORLD, f'<include file="{file}"/>{WORLD}', message, *prepare)  # type: ignore[return-value]


def option(attributes: str, message: str) -> Edit:
    return WORLD, f"<option {attributes}/>{WORLD}", message


def mesh(file: str, message: str, *prepare: Prepare) -> Edit:
    return (MESH, f'<mesh name="wedge" file="{file}"/>', message, *prepare)  # type: ignore[return-value]


def asset(element: str, message: str, *prepare: Prepare) -> Edit:
    """One more beside the mesh."""
    return (MESH, MESH + element, message, *prepare)  # type: ignore[return-value]


MJCF_EDITS: dict[str, Edit] = {
    "includes itself": include("model.xml", "includes itself"),
    "includes in a circle": include(
        "b.xml",
        "'model.xml' includes itself, through ",
        file_of("b.xml", '<mujoco><include file="model.xml"/></mujoco>'),
    ),
    "includes without end": include(
        "part0.xml",
        "includes too many files: 101 files, at most 100; to allow it: --set files=101",
        chain_of_includes,
    ),
    "includes nothing": include("none.xml", "include file 'none.xml' does not"),
    "includes upwards": include("../x.xml", "'../x.xml' leads outside of"),
    "includes from the root": include("/etc/passwd", "'/etc/passwd' leads outside"),
    "includes a link": include(
        "x.xml", "include file 'x.xml' leads outside of", link_to("/etc/passwd", "x.xml")
    ),
    "includes a link in a circle": include(
        "x.xml", "include file 'x.xml' does not exist", link_to("x.xml", "x.xml")
    ),
    "includes a pipe": include("x.xml", "x.xml: not a regular file", fifo("x.xml")),
    "includes a folder": include("parts", "parts: not a regular file"),
    "includes what is no XML": include("parts/wedge.obj", "wedge.obj: not XML"),
    "includes a bomb": include(
        "b.xml", "b.xml: line 1: a document type declaration, refused", file_of("b.xml", LAUGHS + "<mujoco/>")
    ),
    "attaches itself": asset('<model name="m" file="model.xml"/>', "includes itself"),
    "attaches what leads outside": asset(
        '<model name="m" file="b.xml"/>',
        "b.xml: line 1: mesh file '/etc/passwd' leads outside of",
        file_of("b.xml", '<mujoco><asset><mesh name="x" file="/etc/passwd"/></asset></mujoco>'),
    ),
    "file name without end": (MESH, f'<mesh name="m" file="{"x" * 100_000}"/>', "does not exist"),
    "backslashes": mesh("..\\..\\x.obj", "holds a backslash"),
    "missing mesh": mesh("none.stl", "line 4: mesh file 'none.stl' does not"),
    "mesh upwards": mesh("../../../x.stl", "mesh file '../../../x.stl' leads outside of"),
    "mesh from the root": mesh("/dev/zero", "'/dev/zero' leads outside of"),
    "mesh folder upwards": ('"parts"', '"../../.."', "compiler meshdir file '../../..' leads outside"),
    "mesh folder told later": (
        MESH,
        '<mesh name="wedge" file="../../x.stl"/></asset><compiler meshdir="."/><asset>',
        "mesh file '../../x.stl' leads outside of",
    ),
    "mesh without its path": (
        MESH,
        '</asset><compiler strippath="true"/><asset><mesh name="wedge" file="a/pipe.stl"/>',
        "mesh file 'a/pipe.stl' is not a regular file",
        fifo("parts/pipe.stl"),
    ),
    "mesh that is a pipe": mesh(
        "pipe.stl", "mesh file 'pipe.stl' is not a regular file", fifo("parts/pipe.stl")
    ),
    "mesh that is a device": mesh("zero.stl", "leads outside of", link_to("/dev/zero", "parts/zero.stl")),
    "mesh of 20 GB": mesh(
        "big.stl",
        "mesh file 'big.stl' is too large: 20000 MB, at most 100; to allow it: --set asset_size=20000",
        sparse("parts/big.stl", 20_000_000_000),
    ),
    "mesh of noise": mesh("x.stl", "wedge", file_of("parts/x.stl", random.Random(SEED).randbytes(5000))),
    "mesh that promises more": mesh(
        "x.stl", "wedge", file_of("parts/x.stl", b"\0" * 80 + b"\xff\xff\xff\x7f" + b"\0" * 50)
    ),
    "mesh that is flat": mesh(
        "x.obj", "wedge", file_of("parts/x.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nf 1 2 3\nf 2 4 3\n")
    ),
    "mesh of an unknown kind": mesh("x.zzz", "wedge", file_of("parts/x.zzz", WEDGE)),
    "height field that is a device": asset(
        '<hfield name="h" file="/dev/zero" size="1 1 1 1"/>', "hfield file '/dev/zero' leads outside of"
    ),
    "texture that is a device": asset(
        '<texture name="t" type="2d" file="/dev/zero"/>', "texture file '/dev/zero' leads outside of"
    ),
    "face of a texture that is a device": asset(
        '<texture name="t" type="cube" fileright="/dev/zero"/>', "texture file '/dev/zero' leads outside of"
    ),
    "missing skin": asset('<skin name="s" file="none.skn"/>', "skin file 'none.skn' does not exist"),
    "texture without end": asset(
        '<texture name="t" type="2d" builtin="flat" width="100000" height="100000"/>',
        "MB of memory to compile it; to allow more: --set memory=",
    ),
    "height field without end": asset(
        '<hfield name="h" nrow="60000" ncol="60000" size="1 1 1 1"/>',
        "MuJoCo crashes on it (unknown exception), not for lack of memory",
    ),
    "an unknown mesh": ('mesh="wedge"', 'mesh="other"', "other"),
    "an unknown class": (
        '<body name="crank">',
        '<body name="crank" childclass="c">',
        "unknown default childclass Element 'body', line 7",
    ),
    "an unknown element": (WORLD, WORLD + "<robot/>", "robot"),
    "an unknown attribute": ('damping="0.1"', 'dumping="0.1"', "dumping"),
    "an unknown joint type": ('axis="0 1 0" damping', 'type="magic" axis="0 1 0" damping', "magic"),
    "a body twice": ('body name="rocker"', 'body name="crank"', "repeated name 'crank' in body"),
    "a joint twice": ('joint name="axle"', 'joint name="motor"', "repeated name 'motor' in joint"),
    "a keyframe twice": ("</keyframe>", '<key name="start"/></keyframe>', "repeated name 'start' in key"),
    "a long keyframe": ('qpos="0 0 0"', 'qpos="0 0 0 0"', "start"),
    "a huge keyframe": ('qpos="0 0 0"', 'qpos="0 0 1e200"', "key 'start': key_qpos is 1e+200"),
    "no mass": ('mass="0.5" diaginertia="0.001 0.004 0.004"', 'mass="0" diaginertia="0 0 0"', "coupler"),
    "infinite mass": ('mass="0.5"', 'mass="inf"', "line 12: <inertial> has mass='inf', not finite"),
    "mass that is NaN": ('mass="0.5"', 'mass="NaN"', "line 12: <inertial> has mass='NaN', not finite"),
    "mass beyond floats": (
        'mass="0.5"',
        'mass="1e400"',
        "number is too large in attribute 'mass' Element 'inertial', line 12",
    ),
    "mass of 1e300": ('mass="0.5"', 'mass="1e300"', "body 'coupler': body_mass is 1e+300"),
    "unrealisable inertia": ('diaginertia="0.001', 'diaginertia="0.1', "inertia must satisfy A + B >= C"),
    "position of 1e308": ('pos="0.3 0 0"', 'pos="1e308 0 0"', "body 'rocker': body_pos is 1e+308"),
    "axis of nothing": ('axis="0 1 0" damping', 'axis="0 0 0" damping', "axis"),
    "zero quaternion": ('<body name="rocker"', '<body name="rocker" quat="0 0 0 0"', "quat"),
    "huge damping": ('damping="0.1"', 'damping="1e300"', "dof_damping is 1e+300"),
    "huge gain": ('kp="2"', 'kp="1e200"', "actuator 'servo': actuator_biasprm is -1e+200"),
    "huge gravity": option('gravity="0 0 -1e300"', "option: gravity is [ 0."),
    "timestep of nothing": option('timestep="0"', "option: timestep is 0; needed: a positive"),
    "timestep backwards": option('timestep="-1"', "option: timestep is -1; needed: a positive"),
    "a solver without end": option(
        'iterations="1000000000" tolerance="0"',
        "option: iterations is too large: 1e+09 iterations, at most 1000; to allow it: --set iterations=",
    ),
    "a line search without end": option(
        'ls_iterations="1000000000"', "option: ls_iterations is too large: 1e+09 iterations"
    ),
    "control that MuJoCo takes for divergence": (
        'qpos="0 0 0"',
        'qpos="0 0 0" ctrl="1e12"',
        "key 'start': key_ctrl is 1e+12; needed: at most 1e+10",
    ),
    "speed that MuJoCo takes for divergence": (
        'qpos="0 0 0"',
        'qpos="0 0 0" qvel="1e12 0 0"',
        "key 'start': key_qvel is 1e+12; needed: at most 1e+10",
    ),
    "a range turned round": ('kp="2"', 'kp="2" ctrllimited="true" ctrlrange="1 -1"', "invalid control range"),
    "joint range turned round": ('damping="0.1"', 'limited="true" range="1 -1"', "range[0] should be"),
    "negative damping": ('damping="0.1"', 'damping="-10"', "joint 'axle': damping is -10.0; needed: a"),
    "negative stiffness": ('damping="0.1"', 'stiffness="-10"', "joint 'axle': stiffness is -10.0; needed: a"),
    "negative rotor": ('damping="0.1"', 'armature="-1"', "armature of joint 'axle': inertia is -1.0; needed"),
    "angle of 1e14": ('damping="0.1"', 'ref="1e14"', "equality 'close' cannot be closed from start: open by"),
    "mass of 1e14": ('mass="0.5"', 'mass="1e14"', "model.xml: 'coupler' to 'crank': "),
    "mass of nearly nothing": (
        'mass="0.5" diaginertia="0.001 0.004 0.004"',
        'mass="1e-14" diaginertia="1e-16 1e-16 1e-16"',
        "must be larger than mjMINVAL",
    ),
    "body beyond the moon": (
        'pos="0.3 0 0"',
        'pos="1e9 0 0"',
        "equality 'close' cannot be closed from start",
    ),
    "an unknown integrator": option('integrator="magic"', "invalid keyword: 'magic'"),
    "weld to itself": (
        "</equality>",
        '<weld body1="crank" body2="crank"/></equality>',
        "element 'crank' is repeated in equality constraint",
    ),
    "keyframe of a mocap body": ('qpos="0 0 0"', 'qpos="0 0 0" mpos="1"', "invalid mpos size"),
    "keyframes without end": (WORLD, '<size nkey="100000000"/>' + WORLD, "--set compile_time="),
    "joint without a body": (WORLD, WORLD + '<joint name="j"/>', "joint"),
    "loop that cannot close": ('pos="0 0 0.2"', 'pos="9 0 0.2"', "equality 'close' cannot be closed from"),
    "nothing that moves": (MJCF, "<mujoco><worldbody><geom size='1'/></worldbody></mujoco>", "no body can"),
    "many closures": (
        "</equality>",
        '<connect site1="tip" site2="end"/>' * 5000 + "</equality>",
        "5001 closures, at most 100; to allow it: --set closures=5001",
    ),
    "many joints": (
        WORLD,
        WORLD + '<replicate count="301" offset="1 0 0"><body><joint/><geom size="1"/></body></replicate>',
        "304 velocities, at most 300; to allow it: --set velocities=304",
    ),
}


def mjcf_cases() -> Iterator[Case]:
    yield from edited("MJCF", "model.xml", MJCF_EDITS)
    endless = '<replicate count="100000000" offset="1 0 0"><body><joint/><geom size="1"/></body></replicate>'
    long = "x" * 100_000
    for name, text, message in (
        ("macros without end", MJCF.replace(WORLD, WORLD + endless), "needs more than "),
        (
            "100 000 bodies",
            MJCF.replace(WORLD, WORLD + "".join(f'<body name="b{k}"/>' for k in range(100_000))),
            "MuJoCo needs more than ",
        ),
        ("long name twice", MJCF.replace('"crank"', f'"{long}"').replace('"rocker"', f'"{long}"'), "xxx"),
    ):
        yield Case(f"MJCF: {name}", "model.xml", text.encode(), message, slow=True)
    options = (
        (("--set", "color=red"), "model.xml has no option 'color'; choose from: duration"),
        (("--set", "duration=long"), "duration is 'long'; needed: a positive number of seconds"),
        (("--set", "duration=nan"), "duration is 'nan'; needed: a positive number of seconds"),
        (("--set", "duration=-1"), "duration is -1.0; needed: a positive number"),
        (("--set", "output_period=0"), "output_period is 0.0; needed: a positive number"),
        (("--set", "duration=1e300"), "duration is 1e+300; needed: a positive number of seconds, at most"),
        (("--set", "root=/nowhere"), "leads outside of '/nowhere'"),
        (("--set", "loops=loops.yaml"), "loops"),
    )
    yield from with_options("MJCF", "model.xml", options)
