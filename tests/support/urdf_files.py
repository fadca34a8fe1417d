"""Text of URDF files and loop files, and two models made of it."""

from __future__ import annotations

from pathlib import Path

from urdf import read
from urdf.reader import Reading

LOOPS = "closed_loop: {pairs}\ntype: {types}\nname_mot: {motors}\njoint_name: []\njoint_type: []\n"


def link(name: str, mass: float = 1.0) -> str:
    return (
        f'<link name="{name}"><inertial><origin xyz="0.1 0.02 -0.2" rpy="0.1 0.2 0.3"/><mass value="{mass}"/>'
        '<inertia ixx="0.02" ixy="0.001" ixz="0.002" iyy="0.03" iyz="0.003" izz="0.025"/></inertial></link>'
    )


def joint(name: str, kind: str, parent: str, child: str, more: str = "", xyz: str = "0.3 0.1 0") -> str:
    return (
        f'<joint name="{name}" type="{kind}"><origin xyz="{xyz}" rpy="0.3 -0.2 0.5"/>'
        f'<parent link="{parent}"/><child link="{child}"/><axis xyz="0.2 1 0.1"/>'
        f'<limit lower="-1" upper="1" effort="9" velocity="9"/>{more}</joint>'
    )


def robot(*parts: str) -> str:
    return (
        f'<?xml version="1.0" encoding="utf-8"?><robot name="arm"><link name="base"/>{"".join(parts)}</robot>'
    )


CHAIN = robot(
    link("a"),
    link("b", 2.0),
    link("c", 0.5),
    link("d", 0.3),
    joint("first", "revolute", "base", "a", '<dynamics damping="0.5" friction="0.1"/>'),
    joint("second", "prismatic", "a", "b"),
    joint("bolt", "fixed", "b", "c"),
    joint("third", "continuous", "c", "d"),
)

TIPS = (
    link("a"), link("b"), '<link name="tip_a"/>', '<link name="tip_b"/>',
    joint("ja", "revolute", "base", "a", xyz="0 0 0"),
    joint("jb", "revolute", "base", "b", xyz="0.5 0 0"),
    joint("ta", "fixed", "a", "tip_a", xyz="0.3 0 0.4"),
    joint("tb", "fixed", "b", "tip_b", xyz="-0.2 0 0.4"),
)  # fmt: skip


def reading(folder: Path, text: str, loops: str | None = None, base: str = "fixed") -> Reading:
    """Read files of these texts."""
    (folder / "robot.urdf").write_text(text)
    if loops is None:
        return read(folder / "robot.urdf", base=base)
    (folder / "robot.yaml").write_text(loops)
    return read(folder / "robot.urdf", folder / "robot.yaml", base=base)
