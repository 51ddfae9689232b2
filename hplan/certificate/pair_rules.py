"""Link pairs with their own rule instead of the scene's clearance.

`Certificate.min_clearance_m` is a lower bound of every distance that was checked. Two kinds of pairs of one arm have a
rule of their own: pairs that are never as far apart as the clearance must not touch, and have their own certified
bound; exempt pairs (`hplan.collision.self_pairs`) are not checked at all. Pairs of different arms are exempt only
if their cell declares it. Bodies that turn in place, which no joint moves to or from an obstacle, must not touch it,
and are listed if they are nearer than the clearance (`hplan.certificate.turning_in_place`). An obstacle that supports a
body at every value of its joint (`hplan.collision.coal_arm.supports`) is not checked against it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from hplan.certificate.clearance_proof import Proof
from hplan.collision.coal_arm import BASE_DEPTH
from hplan.collision.coal_scene import CoalScene

#: Reason for not checking a body and an obstacle.
_SUPPORTS: Final = f"it supports the link: wherever its joint is, they are within {1e3 * BASE_DEPTH:g} mm"


@dataclass(frozen=True)
class PairRule:
    """A pair of links with a rule of its own.

    Attributes:
        link: Name of a link.
        other: Name of the other link, or of an obstacle.
        rule: The rule, and its reason.
        required_m: Required distance [m]; None for a pair that is not checked.
        clearance_m: Lower bound of the distance of these bodies during the motion [m]; None for a pair that is not
            checked, or whose distance is not proved.
    """

    link: str
    other: str
    rule: str
    required_m: float | None = None
    clearance_m: float | None = None

    def lower_by(self, distance: float) -> PairRule:
        """The rule with its bound lowered by a distance [m]."""
        return self if self.clearance_m is None else replace(self, clearance_m=self.clearance_m - distance)


def pair_rules(checker: CoalScene, proof: Proof, clearance: float) -> tuple[PairRule, ...]:
    """Pairs with their own rule, and proved bounds of their distances.

    Args:
        checker: The arm among the obstacles.
        proof: The proof of its clearance.
        clearance: Clearance that all other pairs keep [m].
    """
    near = _near_at_start(checker, clearance) if proof.is_certified else ()
    return joined_rules([(*_closer_pairs(checker, proof, clearance), *near, *_exempt(checker))])


def joined_rules(parts: Iterable[Sequence[PairRule]]) -> tuple[PairRule, ...]:
    """The rules of several motions; each pair once, with the lowest bound."""
    found = dict[tuple[str, str, str], PairRule]()
    for rule in (rule for part in parts for rule in part):
        key = rule.link, rule.other, rule.rule
        before = found.setdefault(key, rule).clearance_m
        # The lowest bound, or None if one is unknown.
        if before is not None and (rule.clearance_m is None or rule.clearance_m < before):
            found[key] = rule
    return tuple(found.values())


def _closer_pairs(checker: CoalScene, proof: Proof, clearance: float) -> Iterator[PairRule]:
    """Pairs that must not touch, but are always nearer than the clearance."""
    bounds, first = dict(proof.own_bounds), len(checker.pairs) - len(checker.parts.own)
    for number, (pair, required) in enumerate(checker.own_required(clearance)):
        if required < clearance:
            rule = (
                f"they must not touch: at random configurations their distance is at most {1e3 * pair.farthest:.4g} mm"
            )
            yield PairRule(pair.mover_name, pair.other_name, rule, required, bounds.get(first + number))


def _near_at_start(checker: CoalScene, clearance: float) -> Iterator[PairRule]:
    """Pairs that are too near at the start, and come no nearer."""
    required = np.broadcast_to(checker.required_distance(clearance), len(checker.pairs))
    for number in checker.near_pairs.tolist():
        mover, other = checker.pairs[number]
        least = float(required[number])
        rule = f"it is left: at the start their distance is {1e3 * least:.4g} mm, and it becomes no smaller"
        yield PairRule(checker.mover_names[mover], checker.obstacle_names[other], rule, least, least)


def _exempt(checker: CoalScene) -> Iterator[PairRule]:
    """Pairs that are not checked."""
    for link, other, reason in checker.parts.exempt:
        yield PairRule(link, other, f"not checked: {reason}")
    for link, other in checker.supported:
        yield PairRule(link, other, f"not checked: {_SUPPORTS}")
