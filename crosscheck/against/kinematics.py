"""The level of poses, velocities and the motions that constraints allow, whichever joints are cut."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cache

from crosscheck.against.align import Aligned
from crosscheck.against.model import same_kind
from crosscheck.comparison.blame import kinematic_cause
from crosscheck.comparison.kinematics import kinematics_rows as kinematics_rows_of_engines
from crosscheck.comparison.rows import Row
from crosscheck.comparison.samples import Samples, States


def kinematics_rows(
    pair: tuple[str, str], aligned: Aligned, first: Samples, second: Samples
) -> Iterator[Row]:
    """As between engines, see `comparison.kinematics`; what fails is blamed on the joint of either model that
    the other opens, if it can be on one of another kind or that one model has alone.

    On two where nothing tells which is meant: where hinges and balls of a loop change places, an axis that is
    off is in neither model the other's.
    """
    names = {other: name for name, other in aligned.joints.items()}
    suspects = others_in_kind(aligned)

    @cache
    def opened_by_first() -> str | None:
        states = States(second.system.scene, first.states.all)
        found = kinematic_cause(*(Samples(samples.system, states) for samples in (second, first)))
        return names.get(found, found) if found else None

    for row in kinematics_rows_of_engines(pair, first, second):
        if not row.agrees:
            opened = row.where in first.states.scene.mechanism.joint_names
            causes = dict.fromkeys(filter(None, [row.where if opened else None, opened_by_first()]))
            told = [cause for cause in causes if cause in suspects] or list(causes) or [row.where]
            row = replace(row, where=" or ".join(told))
        yield row


def others_in_kind(aligned: Aligned) -> frozenset[str]:
    """Joints that only one model has, or that are of another kind."""
    assert aligned.second is not None
    here, there = aligned.first.mechanism.joint_names, aligned.second.mechanism.joint_names
    alone = {name for name in here if name not in aligned.joints}
    alone |= {name for name in there if name not in aligned.joints.values()}
    return frozenset(alone | {name for name in aligned.joints if not same_kind(aligned, name)})
