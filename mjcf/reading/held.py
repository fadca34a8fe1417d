"""What a compiled model says of the elements that a scene does not hold as they are, in numbers."""

from __future__ import annotations

import hashlib
from typing import Any

import mujoco
import numpy as np

from mjcf.reading.bodies import Bodies, site_point
from mjcf.reading.joints import Joints
from mjcf.reading.start import Start
from newton_euler.model.joint import Key
from newton_euler.scalars import Array
from newton_euler.verification.import_report import FRICTION, RANGE, Part, Value, value

GEOM, WRAP, EQUALITY = mujoco.mjtGeom, mujoco.mjtWrap, mujoco.mjtEq

TOUCH = "contype conaffinity condim priority friction margin gap solref solimp solmix surfacevel adhesion"
"""What MuJoCo has of a geom beside its shape that contacts depend on."""

PAIR = "dim friction margin gap solref solreffriction solimp adhesion"

ACTUATOR = (
    "trntype gear cranklength armature damping dampingpoly dyntype dynprm gaintype gainprm biastype biasprm "
    "ctrllimited ctrlrange forcelimited forcerange actlimited actrange actearly lengthrange delay history"
)
"""All that MuJoCo makes a force of."""

SPRING = "stiffness stiffnesspoly damping dampingpoly lengthspring springyield"
"""Of a tendon."""


class Held:
    """Parts of import reports, by the numbers of MuJoCo's elements; fields are of its arrays of them."""

    def __init__(self, start: Start, bodies: Bodies, joints: Joints) -> None:
        self._start, self._model, self._data = start, start.model, start.data
        self._bodies, self._joints = bodies, joints

    def joint(self, number: int, fields: str = "", of_dofs: str = "") -> Part:
        """With fields of the joint, and of its first velocity."""
        values = self._fields("jnt", number, fields)
        values |= self._fields("dof", int(self._model.jnt_dofadr[number]), of_dofs)
        return Part(self._joints.element(number), values, (self._key(number),))

    def limits(self, number: int) -> Part:
        """Of a joint, from where it starts if it has a coordinate."""
        found = self.joint(number, "margin solref solimp")
        at = self._at(number)
        own = {"range" if at is None else RANGE: value(self._model.jnt_range[number] - (at or 0.0))}
        return Part(found.element, own | found.values, found.joints)

    def friction(self, number: int) -> Part:
        """Dry friction of a joint."""
        found = self.joint(number, of_dofs="frictionloss solref solimp")
        return Part(found.element, {FRICTION: found.values.pop("frictionloss")} | found.values, found.joints)

    def spring(self, number: int) -> Part:
        """What is not linear of a joint, and where that rests from where it starts if it has a coordinate."""
        found = self.joint(number, "stiffnesspoly springyield", "dampingpoly")
        at = self._at(number)
        place = int(self._model.jnt_qposadr[number])
        rest = {} if at is None else {"rest": value(self._model.qpos_spring[place] - at)}
        return Part(found.element, rest | found.values, found.joints)

    def _at(self, number: int) -> float | None:
        """Where a hinge or slide starts; None of a ball or free joint."""
        place = int(self._model.jnt_qposadr[number])
        return float(self._data.qpos[place]) if number in self._joints.keys else None

    def tendon(self, number: int, fields: str) -> Part:
        """With its path."""
        model, element = self._model, f"tendon {self._model.tendon(number).name or number!r}"
        first = int(model.tendon_adr[number])
        path: list[float] = []
        joints: list[Key] = []
        bodies: list[str] = []
        for wrap in range(first, first + int(model.tendon_num[number])):
            kind, target = WRAP(model.wrap_type[wrap]), int(model.wrap_objid[wrap])
            if kind == WRAP.mjWRAP_SITE:
                path.extend(self._data.site_xpos[target])
                bodies.append(self._bodies.names[int(model.site_bodyid[target])])
            elif kind in (WRAP.mjWRAP_SPHERE, WRAP.mjWRAP_CYLINDER):
                path += [model.geom_size[target, 0], *self._data.geom_xpos[target]]
                if kind == WRAP.mjWRAP_CYLINDER:
                    path.extend(self._axis(target))
                side = int(model.wrap_prm[wrap])
                if side >= 0:
                    path.extend(self._data.site_xpos[side])
                bodies.append(self._bodies.names[int(model.geom_bodyid[target])])
            else:  # a joint with its coefficient, or a pulley with its divisor
                path.append(model.wrap_prm[wrap])
                if kind == WRAP.mjWRAP_JOINT:
                    joints.append(self._key(target))
        values = self._fields("tendon", number, fields) | {"path": value(path)}
        return Part(element, values, tuple(joints), tuple(bodies))

    def actuator(self, number: int, fields: str = ACTUATOR) -> Part:
        """With its transmission; with all of its fields also its control and its state at the start."""
        model, data = self._model, self._data
        values = self._fields("actuator", number, fields)
        if fields == ACTUATOR:
            control, state = int(model.actuator_ctrladr[number]), int(model.actuator_actadr[number])
            values["ctrl"] = value(data.ctrl[control : control + int(model.actuator_ctrlnum[number])])
            if state >= 0:
                values["act"] = value(data.act[state : state + int(model.actuator_actnum[number])])
            if (plugin := int(model.actuator_plugin[number])) >= 0:
                values["plugin"] = self.plugin(plugin)
        element = f"actuator {model.actuator(number).name or number!r}"
        target, other = (int(k) for k in model.actuator_trnid[number])
        match mujoco.mjtTrn(model.actuator_trntype[number]):
            case mujoco.mjtTrn.mjTRN_JOINT | mujoco.mjtTrn.mjTRN_JOINTINPARENT:
                return Part(element, values, (self._key(target),))
            case mujoco.mjtTrn.mjTRN_TENDON:
                tendon = self.tendon(target, "")
                return Part(element, values | tendon.values, tendon.joints, tendon.bodies)
            case mujoco.mjtTrn.mjTRN_SITE | mujoco.mjtTrn.mjTRN_SLIDERCRANK:
                sites = [site for site in (target, other) if site >= 0]
                values["pos"] = value([data.site_xpos[site] for site in sites])
                values["axes"] = value([data.site_xmat[site] for site in sites])
                return Part(element, values, (), self._of(site_point(self._start, k)[0] for k in sites))
            case mujoco.mjtTrn.mjTRN_BODY:
                return Part(element, values, (), self._of([target]))
        return Part(element, values)

    def equality(self, number: int) -> Part:
        """With what it is between; of joints and tendons the polynomial."""
        model = self._model
        kind = EQUALITY(model.eq_type[number])
        element = self._start.equality(number)
        ends = [int(k) for k in (model.eq_obj1id[number], model.eq_obj2id[number]) if k >= 0]
        told = {"type": value(kind.name.removeprefix("mjEQ_").lower())}
        if kind == EQUALITY.mjEQ_JOINT:
            polynomial = {"polycoef": value(model.eq_data[number, :5])}
            return Part(element, told | polynomial, tuple(self._key(k) for k in ends))
        if kind == EQUALITY.mjEQ_TENDON:
            tendons = [self.tendon(k, "") for k in ends]
            told["polycoef"] = value(model.eq_data[number, :5])
            told |= {f"path {n}": tendon.values["path"] for n, tendon in enumerate(tendons, start=1)}
            joints = (key for tendon in tendons for key in tendon.joints)
            return Part(element, told, tuple(joints), sum((t.bodies for t in tendons), ()))
        data = {"data": value(model.eq_data[number]), "solref": value(model.eq_solref[number])}
        if model.eq_objtype[number] == mujoco.mjtObj.mjOBJ_SITE:
            data["pos"] = value([self._data.site_xpos[k] for k in ends])
            return Part(element, told | data, (), self._of(site_point(self._start, k)[0] for k in ends))
        of_bodies = model.eq_objtype[number] == mujoco.mjtObj.mjOBJ_BODY
        return Part(element, told | data, (), self._of(ends) if of_bodies else ())

    def geom(self, number: int, fields: str = TOUCH) -> Part:
        """With its shape and where it is."""
        model, name = self._model, self._model.geom(number).name
        body = self._bodies.names[int(model.geom_bodyid[number])]
        element = f"geom {name!r}" if name else f"geom {number} of body {body!r}"
        kind = GEOM(model.geom_type[number])
        values = {"type": value(kind.name.removeprefix("mjGEOM_").lower())}
        values |= self._shape(number, kind) | self._fields("geom", number, fields)
        return Part(element, values, (), (body,))

    def _shape(self, number: int, kind: mujoco.mjtGeom) -> dict[str, Value]:
        """What tells it from others in the world, whatever frame it was given."""
        model, pos = self._model, self._data.geom_xpos[number]
        axes, asset = self._data.geom_xmat[number].reshape(3, 3), int(model.geom_dataid[number])
        if kind == GEOM.mjGEOM_PLANE:  # for contacts it has no ends
            return {"pos": value(axes[:, 2] * (axes[:, 2] @ pos)), "axis": value(axes[:, 2])}
        size = model.geom_size[number]
        if kind == GEOM.mjGEOM_SPHERE:
            return {"size": value(size[:1]), "pos": value(pos)}
        if kind in (GEOM.mjGEOM_CAPSULE, GEOM.mjGEOM_CYLINDER):
            return {"size": value(size[:2]), "pos": value(pos), "axis": value(self._axis(number))}
        if kind == GEOM.mjGEOM_MESH and asset >= 0:
            first = int(model.mesh_vertadr[asset])
            points = model.mesh_vert[first : first + int(model.mesh_vertnum[asset])] @ axes.T + pos
            center = points.mean(axis=0)
            spread = (points - center).T @ (points - center) / len(points)
            return {"pos": value(center), "spread": value(spread), "vertices": value(len(points))}
        told = {"size": value(size), "pos": value(pos), "axes": value(axes)}
        if kind == GEOM.mjGEOM_HFIELD:
            first, count = int(model.hfield_adr[asset]), model.hfield_nrow[asset] * model.hfield_ncol[asset]
            told |= {"size": value(model.hfield_size[asset])}
            told |= summed("data", model.hfield_data[first : first + int(count)])
        return told

    def _axis(self, geom: int) -> Array:
        """(3,) of a cylinder, the same whichever end is the first."""
        axis = self._data.geom_xmat[geom].reshape(3, 3)[:, 2]
        large = axis[np.abs(axis) > 1e-6]
        return np.asarray(axis * np.sign(large[0]))

    def pair(self, number: int) -> Part:
        """A pair of geoms that the file itself lets touch."""
        geoms = [int(k) for k in (self._model.pair_geom1[number], self._model.pair_geom2[number])]
        names = " and ".join(self._model.geom(k).name or str(k) for k in geoms)
        bodies = self._of(int(self._model.geom_bodyid[k]) for k in geoms)
        return Part(f"contact pair {names}", self._fields("pair", number, PAIR), (), bodies)

    def exclude(self, number: int) -> Part:
        """Two bodies that the file lets not touch."""
        signature = int(self._model.exclude_signature[number])
        bodies = sorted(self._of((signature >> 16, signature & 0xFFFF)))
        return Part(f"exclude of {' and '.join(bodies)}", {}, (), tuple(bodies))

    def plugin(self, number: int) -> Value:
        """Its configuration, as MuJoCo keeps it."""
        first = int(self._model.plugin_attradr[number])
        after = [int(k) for k in self._model.plugin_attradr[number + 1 : number + 2]]
        attributes = self._model.plugin_attr[first : after[0] if after else None]
        return value(bytes(attributes.astype(np.uint8)).replace(b"\0", b" ").decode(errors="replace").strip())

    def _key(self, number: int) -> Key:
        return self._joints.keys.get(number, (self._joints.of[number], 0))

    def _of(self, bodies: Any) -> tuple[str, ...]:
        return tuple(self._bodies.names[body] for body in bodies)

    def _fields(self, prefix: str, row: int, fields: str) -> dict[str, Value]:
        return {field: value(getattr(self._model, f"{prefix}_{field}")[row]) for field in fields.split()}


def summed(name: str, array: Array) -> dict[str, Value]:
    """A long array by its length and a digest of its numbers to six digits, which is what files have."""
    numbers = np.asarray(array, dtype=float).ravel()
    digits = " ".join(f"{number:.6g}" for number in numbers)
    return {name: (float(numbers.size), hashlib.sha256(digits.encode()).hexdigest()[:16])}
