"""Hand-written MJCF that tests read: each element of a file once, and four-bar linkages written twice."""

from __future__ import annotations

from pathlib import Path

from mjcf import read
from mjcf.reader import Reading

BAR = '<geom type="capsule" fromto="0 0 0 {0}" size="0.02"/>'

BOX = '<geom type="box" size="0.1 0.2 0.05" pos="{0}"/>'


def model(bodies: str, rest: str = "", compiler: str = "") -> str:
    """A file with these bodies in its world."""
    return f"<mujoco>{compiler}<worldbody>{bodies}</worldbody>{rest}</mujoco>"


def arm(joints: str, more: str = "") -> str:
    """Two bodies, the second with these joints on a hinge of the first."""
    return (
        f'<body name="upper"><joint name="shoulder" axis="0.2 1 0"/>{BAR.format("0.1 0 -0.5")}'
        f'<body name="lower" pos="0.1 0 -0.5" quat="0.9 0.1 0.3 -0.2">{joints}{BAR.format("0.3 0.1 0.2")}'
        f"{more}</body></body>"
    )


FOUR_BAR_BODIES = """
  <body name="crank"><joint name="a" axis="0 1 0"/>
    <geom type="capsule" fromto="0 0 0 0.1 0 0" size="0.01" mass="0.3" contype="0"/>
    <body name="coupler" pos="0.1 0 0"><joint name="b" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 0.25 0 0.1" size="0.01" mass="0.5" contype="0"/></body></body>
  <body name="rocker" pos="0.35 0 -0.1"><joint name="c" axis="0 1 0"/>
    <geom type="capsule" fromto="0 0 0 0 0 0.2" size="0.01" mass="0.4" contype="0"/></body>"""
"""Bodies of a four-bar linkage; an equality connects `coupler` at (0.25, 0, 0.1) with `rocker`."""

PAIR = (
    '<body name="one" pos="0 0 1"><joint name="p" axis="0 1 0"/>'
    '<geom type="box" size="0.1 0.2 0.05" pos="0.2 0 0"/><site name="s1" pos="0.4 0 0"/></body>'
    '<body name="two" pos="1 0 1"><joint name="q" axis="0 1 0"/><joint name="r" type="slide" axis="1 0 0"/>'
    '<geom type="box" size="0.1 0.1 0.3" pos="-0.2 0 0.1"/><site name="s2" pos="-0.5 0 0"/></body>'
)
"""Two bodies on joints of their own, with a site each."""

FLOATING = (
    '<body name="base" pos="0 0 1" quat="0.8 0.2 -0.4 0.4"><freejoint name="root"/>'
    f'{BAR.format("0.3 0 0.1")}<body name="leg" pos="0.3 0 0"><joint name="hip" axis="0 1 0"/>'
    f"{BAR.format('0 0 -0.4')}</body></body>"
)

ELEMENTS = {
    "hinge": model(arm('<joint name="elbow" axis="0 1 0.3" pos="0 0.1 0"/>')),
    "slide": model(arm('<joint name="rail" type="slide" axis="1 1 0"/>')),
    "ball": model(arm('<joint name="ball" type="ball" pos="0.1 0 0"/>')),
    "fixed": model(arm("")),
    "free": model(FLOATING),
    "universal": model(arm('<joint axis="1 0 0"/><joint axis="0 1 0"/>')),
    "oblique hinges": model(arm('<joint axis="1 0 0"/><joint axis="0.5 1 0"/>')),
    "three hinges": model(arm('<joint axis="0 0 1"/><joint axis="1 0 0"/><joint axis="0 1 0.2"/>')),
    "cylindrical": model(arm('<joint type="slide" axis="0 0 1"/><joint axis="0 0 1"/>')),
    "planar": model(
        arm('<joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 0 1"/><joint axis="0 1 0"/>')
    ),
    "slide last": model(arm('<joint axis="0 1 0"/><joint type="slide" axis="1 0 0.2"/>')),
    "slides and a ball": model(
        arm('<joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 1 0.1"/><joint type="ball"/>')
    ),
    "connect": model(PAIR, '<equality><connect body1="one" body2="two" anchor="0.5 0 0"/></equality>'),
    "connect to the world": model(FLOATING, '<equality><connect body1="leg" anchor="0 0 -0.4"/></equality>'),
    "connect of sites": model(PAIR, '<equality><connect site1="s1" site2="s2"/></equality>'),
    "weld": model(
        FLOATING + '<body name="other" pos="0.4 0.1 0.2"><freejoint/><geom size="0.1"/></body>',
        '<equality><weld body1="leg" body2="other" anchor="0.1 0.2 0"/></equality>',
    ),
    "weld at another pose": model(
        FLOATING
        + '<body name="other" pos="0.4 0.1 0.2"><freejoint/><geom size="0.1 0.1 0.2" type="box"/></body>',
        '<equality><weld body1="leg" body2="other" anchor="0.1 0.2 0" '
        'relpose="0.1 0 -0.5 0.8 0 0.6 0"/></equality>',
    ),
    "weld of sites": model(
        FLOATING.replace(
            "</body></body>", '<site name="s1" pos="0 0 -0.4" quat="0.6 0.8 0 0"/></body></body>'
        )
        + '<body name="other" pos="0.4 0.1 0.2"><freejoint/><geom size="0.1"/><site name="s2"/></body>',
        '<equality><weld site1="s1" site2="s2"/></equality>',
    ),
    "joint equality": model(
        PAIR, '<equality><joint joint1="p" joint2="q" polycoef="0.3 -2 0 0 0"/></equality>'
    ),
    "joint held": model(PAIR, '<equality><joint joint1="p" polycoef="0.3 0 0 0 0"/></equality>'),
    "fixed tendon equality": model(
        PAIR,
        '<tendon><fixed name="t"><joint joint="p" coef="2"/><joint joint="r" coef="-0.5"/></fixed></tendon>'
        '<equality><tendon tendon1="t"/></equality>',
    ),
    "rod": model(
        PAIR,
        '<tendon><spatial name="t"><site site="s1"/><site site="s2"/></spatial></tendon>'
        '<equality><tendon name="stay" tendon1="t"/></equality>',
    ),
    "armature": model(PAIR.replace("<joint", '<joint armature="0.3"')),
    "springs and dampers": model(
        PAIR.replace("<joint", '<joint stiffness="20" springref="0.3" ref="0.2" damping="2"')
    ),
    "tendon spring": model(
        PAIR,
        '<tendon><spatial stiffness="30" damping="1" springlength="0.05"><site site="s1"/><site site="s2"/>'
        "</spatial></tendon>",
    ),
    "actuators": model(
        PAIR,
        '<actuator><motor joint="p" gear="3" ctrlrange="-1 1"/>'
        '<position joint="q" kp="20" kv="2" gear="0.5"/><velocity joint="r" kv="4"/>'
        '<motor site="s1" gear="1 2 3 0.1 0.2 0.3"/>'
        '<general joint="p" gainprm="2" biastype="affine" biasprm="0.5 -3 -0.1"/></actuator>'
        '<keyframe><key name="go" qpos="0.2 -0.3 0.1" ctrl="5 0.4 0.2 1.5 0.3"/></keyframe>',
    ),
    "actuator armature": model(PAIR, '<actuator><motor joint="p" gear="10" armature="0.01"/></actuator>'),
    "tendon motor": model(
        PAIR,
        '<tendon><fixed name="t"><joint joint="p" coef="2"/><joint joint="r" coef="-0.5"/></fixed></tendon>'
        '<actuator><motor tendon="t" gear="2"/></actuator><keyframe><key ctrl="1.5"/></keyframe>',
    ),
    "gravity compensation": model(PAIR.replace('name="two"', 'name="two" gravcomp="0.4"')),
    "degrees, sequences, defaults": model(
        '<body name="a" euler="30 20 10"><joint axis="0 1 0" class="soft"/>'
        '<geom type="ellipsoid" size=".1 .2 .3"/><body name="b" pos="0.5 0 0" axisangle="1 0 0 40">'
        '<inertial pos="0.1 0 0" mass="2" '
        'fullinertia="0.1 0.2 0.25 0.01 0.02 0.03"/><joint axis="1 0 1" ref="10"/></body></body>',
        "",
        '<compiler angle="degree" eulerseq="zyx"/><default><default class="soft"><joint stiffness="2" '
        'springref="20" armature="0.1"/></default></default>',
    ),
    "mocap": model(
        PAIR + '<body name="hand" mocap="true" pos="0.4 0 1.2"/>',
        '<equality><connect body1="hand" body2="one" anchor="0 0 -0.1"/></equality>',
    ),
    "flags": model(PAIR, "", '<option gravity="1 2 -3"><flag gravity="disable"/></option>'),
    "without gravity's flag": model(PAIR, "", '<option gravity="1 2 -3" density="0"/>'),
}
"""One element each, or a few."""

A, B, C, D = "0 0 0", "0.1 0 0.4", "0.9 0 0.7", "1 0 0"


def _link(name: str, joint: str, mass: float, end: str, inner: str = "", pos: str = "0 0 0") -> str:
    center = " ".join(str(0.5 * float(x)) for x in end.split())
    return (
        f'<body name="{name}" pos="{pos}"><joint name="{joint}" axis="0 1 0"/>'
        f'<inertial pos="{center}" mass="{mass}" diaginertia="0.02 0.03 0.015"/>{inner}</body>'
    )


FOUR_BARS = {
    "cut at C by a connect": model(
        _link("crank", "a", 1, "0.1 0 0.4", _link("coupler", "b", 2, "0.8 0 0.3", pos=B))
        + _link("rocker", "d", 1.5, "-0.1 0 0.7", pos=D),
        '<equality><connect name="c" body1="coupler" body2="rocker" anchor="0.8 0 0.3"/></equality>',
    ),
    "cut at B by a connect of sites": model(
        _link("crank", "a", 1, "0.1 0 0.4", '<site name="sb" pos="0.1 0 0.4"/>')
        + _link(
            "rocker", "d", 1.5, "-0.1 0 0.7",
            # the coupler from its other end
            '<body name="coupler" pos="-0.9 0 0.4"><joint name="c" axis="0 1 0" pos="0.8 0 0.3"/>'
            '<inertial pos="0.4 0 0.15" mass="2" diaginertia="0.02 0.03 0.015"/><site name="sc"/></body>',
            pos=D,
        ),
        '<equality><connect name="b" site1="sb" site2="sc"/></equality>',
    ),
    "cut through the rocker by a weld": model(
        _link(
            "crank", "a", 1, "0.1 0 0.4",
            _link(
                "coupler", "b", 2, "0.8 0 0.3",
                '<body name="half" pos="0.8 0 0.3"><joint name="c" axis="0 1 0"/>'
                '<inertial pos="0.05 0 -0.35" mass="0.75" diaginertia="0.01 0.015 0.0075"/></body>',
                pos=B,
            ),
        )
        + '<body name="rocker" pos="1 0 0"><joint name="d" axis="0 1 0"/>'
        '<inertial pos="-0.05 0 0.35" mass="0.75" diaginertia="0.01 0.015 0.0075"/></body>',
        '<equality><weld name="w" body1="rocker" body2="half"/></equality>',
    ),
}  # fmt: skip
"""One four-bar linkage."""


def reading(folder: Path, text: str, **options: object) -> Reading:
    path = folder / "model.xml"
    path.write_text(text)
    return read(path, **options)  # type: ignore[arg-type]


def verified(found: Reading) -> bool:
    """Whether the report says that it was compared with MuJoCo's own model of the file; it would not be there
    if that had shown a difference."""
    return any(line.startswith("verified against the file's own model") for line in found.report.start)


LOOP = """<mujoco model="loop"><compiler angle="radian"/><option timestep="0.002"/>
<default><geom type="capsule" size="0.01" density="900" contype="0" conaffinity="0"/></default><worldbody>
<body name="crank"><joint name="a" axis="0 1 0"/><geom fromto="0 0 0 0 0 0.15"/>
<body name="rod" pos="0 0 0.15"><joint name="b" axis="0 1 0"/><geom fromto="0 0 0 0.4 0 0"/>
<site name="tip" pos="{reach} 0 0"/></body></body>
<body name="lever" pos="0.4 0 0"><joint name="c" axis="0 1 0"/><geom fromto="0 0 0 0 0 0.15"/>
<site name="eye" pos="0 0 0.15"/></body></worldbody>
<equality><connect name="close" site1="tip" site2="eye"/></equality></mujoco>"""
"""A parallelogram that is closed at the start if the rod's tip is 0.4 m from its hinge."""
