"""URDF and loop files that are refused: names, trees, numbers, entries, options."""

from __future__ import annotations

from collections.abc import Iterator

from hostile_files import ALIASES, LOOPS, URDF, Case, edited, with_options

MASS, INERTIA = '<mass value="0.5"/>', 'ixx="0.002" ixy="0" ixz="0" iyy="0.003" iyz="0" izz="0.002"'

ROCKER = '<parent link="base"/>\n    <child link="rocker"/>'

URDF_EDITS: dict[str, tuple[str, str, str]] = {
    "a link twice": ('link name="rocker"', 'link name="crank"', "link 'crank': 2 of that name"),
    "a joint twice": ('joint name="axle"', 'joint name="motor"', "joint 'motor': 2 of that name"),
    "a link without a name": ('<link name="rocker"', "<link", "a link without a name"),
    "a joint without a name": ('<joint name="axle"', "<joint", "a joint without a name"),
    "an unknown parent": (ROCKER, ROCKER.replace("base", "x"), "joint 'axle': parent link 'x' does not"),
    "an unknown child": (ROCKER, ROCKER.replace("rocker", "x"), "joint 'axle': child link 'x' does not"),
    "no parent": (ROCKER, '<child link="rocker"/>', "joint 'axle': parent link None does not exist"),
    "an unknown type": ('axle" type="continuous', 'axle" type="magic', "joint 'axle': unknown type 'magic'"),
    "no type": ('axle" type="continuous"', 'axle"', "joint 'axle': unknown type None"),
    "a circle of links": (
        '<parent link="base"/>\n    <child link="crank"/>',
        '<parent link="coupler"/>\n    <child link="crank"/>',
        "link 'crank': its joints form a circle",
    ),
    "nothing but a circle": (
        "</robot>",
        '<joint name="j" type="fixed"><parent link="coupler"/><child link="base"/></joint></robot>',
        "its joints form a circle; needed: a tree",
    ),
    "a joint to itself": (
        ROCKER,
        ROCKER.replace("base", "rocker"),
        "'rocker': its joints form",
    ),
    "two parents": (ROCKER, ROCKER.replace("rocker", "crank"), "child of both joint 'motor' and 'axle'"),
    "two roots": ("</robot>", '<link name="lonely"/></robot>', "links 'base' and 'lonely': no joint leads"),
    "no links": (URDF, '<robot name="empty"/>', "no links"),
    "nothing that moves": (
        URDF,
        '<robot name="still"><link name="a"/></robot>',
        "loops.yaml: name_mot: the URDF has no",
    ),
    "negative mass": (MASS, '<mass value="-1"/>', "link 'crank': mass is -1 kg; needed: none below 0"),
    "no mass": (MASS, '<mass value="0"/>', ""),
    "mass in words": (MASS, '<mass value="heavy"/>', "link 'crank': <mass> has value='heavy'"),
    "mass in hexadecimal": (MASS, '<mass value="0x1"/>', "link 'crank': <mass> has value='0x1'"),
    "mass that is NaN": (MASS, '<mass value="nan"/>', "link 'crank': <mass> has value='nan'"),
    "mass without end": (MASS, '<mass value="inf"/>', "link 'crank': <mass> has value='inf'"),
    "mass beyond floats": (MASS, '<mass value="1e400"/>', "link 'crank': <mass> has value='1e400'"),
    "mass of 1e300": (MASS, '<mass value="1e300"/>', "link 'crank': <mass> has value='1e300'"),
    "mass without a value": (MASS, "<mass/>", "link 'crank': <mass> has no value"),
    "negative inertia": (INERTIA, INERTIA.replace("0.003", "-0.003"), "link 'crank': principal moments"),
    "no inertia": (INERTIA, INERTIA.replace("0.003", "0").replace("0.002", "0"), "crank"),
    "indefinite inertia": (INERTIA, INERTIA.replace('ixy="0"', 'ixy="1"'), "link 'crank': principal"),
    "half an inertia": (INERTIA, 'ixx="0.002"', "link 'crank': <inertia> has no ixy"),
    "two numbers": ('xyz="0.1 0 0.05"', 'xyz="0.1 0"', "<origin> has xyz='0.1 0'; needed: 3 numbers"),
    "numbers with commas": ('xyz="0.1 0 0.05"', 'xyz="0.1,0,0.05"', "needed: 3 numbers"),
    "position of 1e308": ('xyz="0.1 0 0.05"', 'xyz="1e308 0 0"', "<origin> has xyz='1e308 0 0'"),
    "angle that is NaN": ('rpy="0 0 0.2"', 'rpy="0 0 nan"', "<origin> has rpy='0 0 nan'"),
    "axis of nothing": ('<axis xyz="0 1 0"/>', '<axis xyz="0 0 0"/>', "motor"),
    "mimics nothing": (
        ROCKER,
        ROCKER + '<mimic joint="none"/>',
        "joint 'axle': mimics 'none', which does not exist",
    ),
    "mimics itself": (
        ROCKER,
        ROCKER + '<mimic joint="axle"/>',
        "joint 'axle': mimics 'axle', itself",
    ),
    "mimics without a name": (
        ROCKER,
        ROCKER + "<mimic/>",
        "joint 'axle': mimics None, which does not exist",
    ),
    "mimics in words": (ROCKER, ROCKER + '<mimic joint="motor" multiplier="two"/>', "has multiplier='two'"),
    "a limit missing": (
        'axle" type="continuous"',
        'axle" type="revolute"',
        "Joint [axle] is of type REVOLUTE",
    ),
    "half an axis": (
        '<axis xyz="0 1 0"/>',
        '<axis xyz="0 1"/>',
        "joint 'motor': <axis> has xyz='0 1'; needed",
    ),
    "dynamics of nothing": (ROCKER, ROCKER + "<dynamics/>", "joint_dynamics element for joint [axle]"),
    "a robot without a name": ('<robot name="linkage"', "<robot", "No name given for the robot"),
    "joint named universe": ('joint name="axle"', 'joint name="universe"', "joint is named 'universe'"),
    "loop that cannot close": ('xyz="0.3 0 0"', 'xyz="9 0 0"', "loop of tip and end cannot be closed"),
    "an escape in a name": (
        ROCKER,
        ROCKER.replace("rocker", "a\u009b31m"),
        "child link 'a\\x9b31m' does not exist",
    ),
    "a turned name": (
        ROCKER,
        ROCKER.replace("rocker", "\u202erekcor"),
        "child link '\\u202erekcor' does not exist",
    ),
    "a null as a number": ("<robot", "<robot version='&#0;'", "not XML"),
}


def star(count: int, kind: str) -> bytes:
    """A URDF of many links on one."""
    links = "".join(f'<link name="l{k}"/>' for k in range(count))
    joints = "".join(
        f'<joint name="j{k}" type="{kind}"><parent link="base"/><child link="l{k}"/></joint>'
        for k in range(count)
    )
    return f'<robot name="star"><link name="base"/>{links}{joints}</robot>'.encode()


def chain(count: int) -> bytes:
    """A URDF of many links in a row."""
    links = "".join(f'<link name="l{k}"/>' for k in range(count + 1))
    joints = "".join(
        f'<joint name="j{k}" type="fixed"><parent link="l{k}"/><child link="l{k + 1}"/></joint>'
        for k in range(count)
    )
    return f'<robot name="chain">{links}{joints}</robot>'.encode()


def urdf_cases() -> Iterator[Case]:
    yield from edited("URDF", "robot.urdf", URDF_EDITS)
    for name, content, message in (
        (
            "40 000 links",
            star(40_000, "fixed"),
            "40001 bodies, at most 2000; to allow it: --set bodies=40001",
        ),
        (
            "40 000 links in a row",
            chain(40_000),
            "40001 bodies, at most 2000; to allow it: --set bodies=40001",
        ),
        (
            "301 hinges",
            star(301, "continuous"),
            "301 velocities, at most 300; to allow it: --set velocities=301",
        ),
        (
            "2000 links that do not move",
            chain(1999),
            "loops.yaml: name_mot: the URDF has no moving joint 'motor'",
        ),
    ):
        yield Case(f"URDF: {name}", "robot.urdf", content, message, slow=True)
    options = (
        (("--set", "key=start"), "robot.urdf has no option 'key'; choose from: duration, output_period"),
        (("--set", "duration=inf"), "duration is 'inf'; needed: a positive number of seconds"),
        (("--set", "loops=none.yaml"), "none.yaml: cannot be read: No such file or directory"),
        (("--set", "loops=parts"), "parts: not a regular file"),
        (("--set", "loops=parts/wedge.obj"), "parts/wedge.obj: document: not a mapping"),
        (("--set", "loops=robot.urdf"), "robot.urdf: document: not"),
    )
    yield from with_options("URDF", "robot.urdf", options)


LOOP_EDITS: dict[str, tuple[str, str, str]] = {
    "types that are null": ("[3d]", "", "type: '' is not a list"),
    "an unknown frame": ("[tip, end]", "[tip, nowhere]", "the URDF has no link or joint 'nowhere'"),
    "a frame to itself": ("[tip, end]", "[tip, tip]", "closed_loop: ['tip', 'tip'] is one frame"),
    "a pair that is none": ("[[tip, end]]", "[tip, end]", "closed_loop: 'tip' is not a pair of frame names"),
    "a motor that is fixed": ("[motor]", "[to_tip]", "name_mot: the URDF has no moving joint 'to_tip'"),
    "a key twice": ("name_mot", "type: [6d]\nname_mot", "document: not YAML: line 3: key 'type' is given"),
    "an alias": ("[3d]", "&a [*a]", "document: not YAML: line 2: aliases are not allowed here"),
    "an object": ("[3d]", "!!python/object/apply:os.system [touch owned]", "line 2: tags are not allowed"),
    "a date that is none": ("[3d]", "2001-99-99", "type: '2001-99-99' is not a list"),
    "a document more": ("name_mot", "---\nname_mot", "document: not YAML: line 3: a second document"),
    "a tab": ("[3d]", "\n\t- 3d", "document: not YAML: line 3: found character that cannot start"),
    "a key that is a list": ("name_mot", "? [a]\n: b\nname_mot", "line 3: a key is not a text"),
    "an escape": ("[tip, end]", '[tip, "a\\x1b[31m"]', "the URDF has no link or joint 'a\\x1b[31m'"),
    "a long name": ("[tip, end]", f"[tip, {'x' * 100_000}]", "the URDF has no link or joint 'xxx"),
    "deep nesting": ("[3d]", "[" * 100_000, "line 2: nested too deeply"),
    "deep nesting in blocks": ("[3d]", "\n" + "- " * 100_000, "line 3: nested too deeply"),
    "many pairs": (
        "closed_loop: [[tip, end]]\ntype: [3d]",
        f"closed_loop: [{'[tip, end], ' * 10_000}]\ntype: [{'3d, ' * 10_000}]",
        "closed_loop: 10000 closures, at most 100; to allow it: --set closures=10000",
    ),
    "too long": ("[3d]", "[3d] #" + "x" * 1_000_000, "MB, at most 1; to allow it: --set scene_size=2"),
}


def loop_cases() -> Iterator[Case]:
    yield from edited("loops", "loops.yaml", LOOP_EDITS)
    text = ALIASES + LOOPS.replace("[3d]", "*a40")
    yield Case("loops: aliases that unfold", "loops.yaml", text.encode(), "aliases are not allowed here")
