"""Scenes from YAML or JSON files. Pydantic checks the form, the mechanism checks the mechanics."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from crosscheck.errors import CrosscheckError
from newton_euler.control import PD
from newton_euler.errors import NewtonEulerError
from newton_euler.joints import JOINT_KINDS, Joint
from newton_euler.mechanism import Body, Mechanism
from newton_euler.scene import Scene

MAXIMUM_BYTES = 10_000_000

Number = Annotated[float, Field(strict=False, allow_inf_nan=False)]
Vector = tuple[Number, Number, Number]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid")


class BodyEntry(_Strict):
    """A body; world frame at the initial pose, SI."""

    name: str
    mass: Number
    center_of_mass: Vector
    inertia: tuple[Vector, Vector, Vector]
    quaternion: tuple[Number, Number, Number, Number] = (1.0, 0.0, 0.0, 0.0)


class JointEntry(_Strict):
    """A joint; which axes it needs depends on its kind."""

    name: str
    kind: str
    first: str
    second: str
    point: Vector
    point_on_second: Vector | None = None
    axis: Vector | None = None
    axis_on_first: Vector | None = None
    axis_on_second: Vector | None = None
    actuated: bool = False

    def build(self) -> Joint:
        where = f"joint {self.name!r}"
        if self.kind not in JOINT_KINDS:
            raise CrosscheckError(
                f"{where}: unknown kind {self.kind!r}; choose from: {', '.join(JOINT_KINDS)}"
            )
        kind = JOINT_KINDS[self.kind]
        given = {
            name: getattr(self, name)
            for name in ("axis", "axis_on_first", "axis_on_second")
            if getattr(self, name) is not None
        }
        if set(given) != set(kind.axis_names):
            raise CrosscheckError(
                f"{where}: a {self.kind} joint needs {' and '.join(kind.axis_names) or 'no axis'}, "
                f"got {' and '.join(given) or 'none'}"
            )
        arguments: dict[str, Any] = given | {
            "point_on_second": self.point_on_second,
            "actuated": self.actuated,
        }
        return kind(self.name, self.first, self.second, self.point, **arguments)  # type: ignore[arg-type]


class ControlEntry(_Strict):
    """A PD law; `target` is a joint coordinate, zero at the initial pose."""

    joint: str
    stiffness: Number
    damping: Number
    target: Number
    coordinate: int = 0


class SceneEntry(_Strict):
    """A scene file."""

    name: str
    description: str = ""
    gravity: Vector = (0.0, 0.0, 0.0)
    duration: Number
    output_period: Number
    ground: str = "ground"
    bodies: list[BodyEntry]
    joints: list[JointEntry]
    control: list[ControlEntry] = []


def read_scene(path: str) -> Scene:
    """Read a scene file.

    Raises:
        CrosscheckError: naming the file and the field at fault.
    """
    try:
        if Path(path).stat().st_size > MAXIMUM_BYTES:
            raise CrosscheckError(f"{path}: larger than {MAXIMUM_BYTES} bytes")
        text = Path(path).read_text(encoding="utf-8")
        entry = SceneEntry.model_validate(yaml.safe_load(text))
        bodies = [Body.ground(entry.ground)]
        bodies += [Body(**body.model_dump()) for body in entry.bodies]
        return Scene(
            entry.name,
            Mechanism(bodies, [joint.build() for joint in entry.joints]),
            entry.duration,
            entry.output_period,
            entry.gravity,  # type: ignore[arg-type]
            tuple(PD(**law.model_dump()) for law in entry.control),
            description=entry.description,
        )
    except OSError as error:
        raise CrosscheckError(f"cannot read {path}: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise CrosscheckError(f"{path}: not a UTF-8 text file") from error
    except (yaml.YAMLError, RecursionError) as error:
        raise CrosscheckError(f"{path}: not YAML: {' '.join(str(error).split())}") from error
    except ValidationError as error:
        first = error.errors()[0]
        field = ".".join(str(part) for part in first["loc"]) or "file"
        raise CrosscheckError(f"{path}: {field}: {first['msg']} (got {first['input']!r:.60})") from error
    except (NewtonEulerError, CrosscheckError) as error:
        raise CrosscheckError(f"{path}: {error}") from error
