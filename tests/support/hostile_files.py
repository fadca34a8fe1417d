"""Small models with nothing wrong, what a case of a broken one is, and files that are worse than broken."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import yaml
from command_line import short_example

SEED = 5

MJCF = """\
<mujoco model="linkage">
  <compiler meshdir="parts"/>
  <asset>
    <mesh name="wedge" file="wedge.obj"/>
  </asset>
  <worldbody>
    <body name="crank">
      <joint name="motor" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 0 0 0.1" size="0.01"/>
      <body name="coupler" pos="0 0 0.1">
        <joint name="elbow" axis="0 1 0"/>
        <inertial pos="0.15 0 0.02" mass="0.5" diaginertia="0.001 0.004 0.004"/>
        <site name="tip" pos="0.3 0 0.1"/>
      </body>
    </body>
    <body name="rocker" pos="0.3 0 0">
      <joint name="axle" axis="0 1 0" damping="0.1"/>
      <geom type="mesh" mesh="wedge"/>
      <site name="end" pos="0 0 0.2"/>
    </body>
  </worldbody>
  <equality>
    <connect name="close" site1="tip" site2="end"/>
  </equality>
  <actuator>
    <position name="servo" joint="motor" kp="2"/>
  </actuator>
  <keyframe>
    <key name="start" qpos="0 0 0"/>
  </keyframe>
</mujoco>
"""

WEDGE = "v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nv 0 0 0.2\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"


def _link(name: str) -> str:
    return (
        f'  <link name="{name}">\n    <inertial>\n      <origin xyz="0.1 0 0.05" rpy="0 0 0.2"/>\n'
        '      <mass value="0.5"/>\n'
        '      <inertia ixx="0.002" ixy="0" ixz="0" iyy="0.003" iyz="0" izz="0.002"/>\n'
        "    </inertial>\n  </link>\n"
    )


def _joint(name: str, kind: str, parent: str, child: str, xyz: str) -> str:
    return (
        f'  <joint name="{name}" type="{kind}">\n    <origin xyz="{xyz}"/>\n    <parent link="{parent}"/>\n'
        f'    <child link="{child}"/>\n    <axis xyz="0 1 0"/>\n  </joint>\n'
    )


URDF = (
    '<robot name="linkage">\n  <link name="base"/>\n  <link name="tip"/>\n  <link name="end"/>\n'
    + "".join(map(_link, ("crank", "coupler", "rocker")))
    + _joint("motor", "continuous", "base", "crank", "0 0 0")
    + _joint("elbow", "continuous", "crank", "coupler", "0 0 0.1")
    + _joint("axle", "continuous", "base", "rocker", "0.3 0 0")
    + _joint("to_tip", "fixed", "coupler", "tip", "0.3 0 0.1")
    + _joint("to_end", "fixed", "rocker", "end", "0 0 0.2")
    + "</robot>\n"
)

LOOPS = "closed_loop: [[tip, end]]\ntype: [3d]\nname_mot: [motor]\njoint_name: []\njoint_type: []\n"

SCENE = yaml.safe_dump(short_example())

TEXTS = {
    "model.xml": MJCF,
    "robot.urdf": URDF,
    "loops.yaml": LOOPS,
    "scene.yaml": SCENE,
    "scene.json": json.dumps(short_example(), indent=1),
}
"""Files with nothing wrong."""

Prepare = Callable[[Path], None]


@dataclass(frozen=True)
class Case:
    """One broken file and the command line that reads it.

    Attributes:
        name: of the case.
        file: name of the file that is at fault.
        content: of that file, or what makes it, if that takes long.
        message: what has to be in the line that refuses it; None if it may have stayed a model.
        arguments: beside the file.
        prepare: makes other files in the folder.
        slow: takes a second or more.
    """

    name: str
    file: str
    content: bytes | Callable[[], bytes]
    message: str | None = None
    arguments: tuple[str, ...] = ()
    prepare: Prepare | None = None
    slow: bool = False

    @property
    def blames(self) -> str:
        """Name of the file that the line has to name; none if the command line itself is at fault."""
        first = (self.message or "").split(":")[0]
        if first.endswith((".xml", ".obj", ".yaml", "parts")):
            return first
        return "" if self.arguments else self.file

    def make(self, folder: Path) -> list[str]:
        """Write the files; the command line."""
        (folder / "parts").mkdir(parents=True)
        (folder / "parts" / "wedge.obj").write_text(WEDGE)
        for name in ("robot.urdf", "loops.yaml"):
            (folder / name).write_text(TEXTS[name])
        content = self.content() if callable(self.content) else self.content
        (folder / self.file).write_bytes(content)
        if self.prepare:
            self.prepare(folder)
        source = "robot.urdf" if self.file == "loops.yaml" else self.file
        closed = source == "robot.urdf" and not any("loops=" in argument for argument in self.arguments)
        loops = ["--set", "loops=loops.yaml"] if closed else []
        if self.message is None:
            return ["convert", source, "out.yaml", *loops]
        return ["run", source, *loops, "--output", "out", *self.arguments]


def edited(
    label: str, file: str, edits: Mapping[str, tuple[str, str, str] | tuple[str, str, str, Prepare]]
) -> Iterator[Case]:
    """A file with one text in it exchanged: what was, what is, what has to be said, and what else is made."""
    for name, (old, new, message, *prepare) in edits.items():
        text = TEXTS[file]
        assert old in text, name
        content = text.replace(old, new, 1).encode()
        yield Case(f"{label}: {name}", file, content, message, prepare=prepare[0] if prepare else None)


def with_options(label: str, file: str, options: Iterable[tuple[tuple[str, ...], str]]) -> Iterator[Case]:
    """A file with nothing wrong, and a command line that does not fit it."""
    for arguments, message in options:
        name = f"{label}: options {' '.join(arguments)}"
        yield Case(name, file, TEXTS[file].encode(), message, arguments)


def fifo(name: str) -> Prepare:
    return lambda folder: os.mkfifo(folder / name)


def link_to(target: str, name: str) -> Prepare:
    return lambda folder: (folder / name).symlink_to(target)


def file_of(name: str, content: bytes | str) -> Prepare:
    def make(folder: Path) -> None:
        (folder / name).write_bytes(content if isinstance(content, bytes) else content.encode())

    return make


def sparse(name: str, size: int) -> Prepare:
    def make(folder: Path) -> None:
        with (folder / name).open("wb") as stream:
            stream.truncate(size)

    return make


def chain_of_includes(folder: Path) -> None:
    for k in range(150):
        (folder / f"part{k}.xml").write_text(f'<mujoco><include file="part{k + 1}.xml"/></mujoco>')


LAUGHS = "<!DOCTYPE x [<!ENTITY a0 'ha'>" + "".join(
    f"<!ENTITY a{k + 1} '{f'&a{k};' * 10}'>" for k in range(9)
) + "]>"  # fmt: skip
"""The billion laughs: entities of ten entities each."""

ALIASES = "a: &a0 1\n" + "".join(f"b{k}: &a{k + 1} [*a{k}, *a{k}]\n" for k in range(40))
"""The same in YAML: 2^40 numbers."""
