"""Limits of force and stress for wood that bends, and the properties and assumptions that contacts are bounded with.

`hplan.scene.limb_contacts` turns them into solids with permitted depths.
"""

from __future__ import annotations

from collections.abc import Collection
from fnmatch import fnmatchcase
from functools import lru_cache
from typing import Annotated, Any, Final, NamedTuple

import numpy as np
from pydantic import BeforeValidator, Field, model_validator

from hplan.base.arrays import FloatArray
from hplan.base.checked import StrictModel, fault
from hplan.errors import SceneError
from hplan.scene.limbs import CLAMP_RADIUS_M, Limbs
from hplan.scene.obstacle_kind import Name, to_tuple

#: Share of the limits of force and stress for the deflection; the rest is for impacts.
STATIC_SHARE: Final = 0.7

#: Impacts in a row, the return of a limb that was thrown ahead, and forks near a contact raise the first impact by at
#: most this factor: the largest one found in 800 simulated pushes was 2.4 (`scripts/benchmark.py wood_moving`).
IMPACT_FACTOR: Final = 2.6

#: Maximum rotation of a limb at a contact, and the growth of its force over that of small deflections with the square
#: of the rotation. A cantilever that is bent by a third of its length turns by 0.46 and needs 1.1 times the force of
#: linear theory (Bisshopp and Drucker 1945), and the normal of the contact turns with it, which adds 1 / cos.
MOST_ROTATION: Final = 0.45
LARGE_ROTATION_FORCE: Final = 1.2

#: Depths below this count as rigid [m].
LEAST_DEPTH_M: Final = 5e-4

#: Maximum distance between the surfaces of a fruit and the limb that it hangs from [m].
STALK_M: Final = 0.03

#: Maximum deflection of a fruit per length of its pendulum. The force is counted with the secant stiffness there.
MOST_SWING: Final = 0.8

#: Acceleration of gravity [m/s^2].
GRAVITY: Final = 9.81

#: Assumed minimum damping ratio of limbs, and of fruit on their stalks, after a push.
DAMPING_RATIO: Final = 0.05

_Positive = Annotated[float, Field(gt=0.0, le=1e12)]


_Modulus = tuple[_Positive, _Positive]


class LimbLimits(StrictModel):
    """Limits of some limbs and fruit, in place of those of the scene.

    Attributes:
        names: Names of the limbs and fruit; `*` stands for any characters.
        contact_force: As in `Wood`, as are all others; None for the scene's.
        wood_stress_mpa: Holds for all contacts whose force bends one of these limbs.
        fruit_force: For fruit among the names.
        youngs_modulus_gpa: Must be the same for all segments of a limb, from its clamp on.

    Examples:
        >>> from hplan.scene import LimbLimits, Wood
        >>> wood = Wood(limits=(LimbLimits(names=("tree 2 *",), contact_force=4.0),))
        >>> wood.of("tree 2 branch 1").contact_force, wood.of("tree 1 branch 1").contact_force
        (4.0, 10.0)
    """

    names: Annotated[tuple[Name, ...], BeforeValidator(to_tuple), Field(min_length=1)]
    contact_force: _Positive | None = None
    wood_stress_mpa: _Positive | None = None
    fruit_force: _Positive | None = None
    youngs_modulus_gpa: _Modulus | None = None

    @model_validator(mode="after")
    def _states_a_limit(self) -> LimbLimits:
        if not self.given:
            raise ValueError(f"give at least one of {', '.join(_OVERRIDDEN)}")
        _check_interval(self.youngs_modulus_gpa)
        return self

    @property
    def given(self) -> dict[str, Any]:
        """The limits that are given."""
        values = {key: getattr(self, key) for key in _OVERRIDDEN}
        return {key: value for key, value in values.items() if value is not None}

    def is_for(self, name: str) -> bool:
        """True if the limits hold for the limb or fruit of a name."""
        return any(fnmatchcase(name, each) for each in self.names)


#: Limits of force and stress, and all fields of `LimbLimits`.
_LIMITS: Final = ("contact_force", "wood_stress_mpa", "fruit_force")
_OVERRIDDEN: Final = (*_LIMITS, "youngs_modulus_gpa")


def _check_interval(modulus_gpa: _Modulus | None) -> None:
    if modulus_gpa is not None and modulus_gpa[0] > modulus_gpa[1]:
        low, high = modulus_gpa
        raise fault(f"expected the minimum first, got {low:g} and {high:g}", "youngs_modulus_gpa")


class Wood(StrictModel):
    """Limits for contact with wood and fruit, and the mechanical properties that they are bounded with.

    Young's modulus is an interval: the stiffer end bounds forces. Living branches have 0.7 to 4.6 GPa (Cannell and
    Morgan 1987), green timber up to 7.5 GPa; green stems break at 35 to 50 MPa, branches at 38 to 70 MPa, and apples
    detach at 20 to 25 N (Hussain 2022). Certificates hold for wood within these values.

    Attributes:
        contact_force: Maximum force of a link on a limb [N].
        wood_stress_mpa: Maximum bending stress of a limb [MPa].
        fruit_force: Maximum force on the stalk of a fruit that a link pushes aside [N].
        youngs_modulus_gpa: Minimum and maximum of Young's modulus [GPa].
        clamp_radius: Radius from which wood does not bend [m].
        density: Density of wood [kg/m^3].
        fruit_density: Density of fruit [kg/m^3].
        contact_stiffness: Stiffness of the contact between link and limb, for impacts [N/m].
        capture_range: Maximum displacement of the goal fruit at the grasp by everything pushed before [m].
        limits: Limits of single limbs and fruit in place of these; of several for one name the last one holds.

    Examples:
        >>> from hplan.scene import Wood
        >>> Wood(contact_force=5.0).youngs_modulus_gpa
        (0.7, 5.0)
    """

    contact_force: _Positive = 10.0
    wood_stress_mpa: _Positive = 30.0
    fruit_force: _Positive = 8.0
    youngs_modulus_gpa: _Modulus = (0.7, 5.0)
    clamp_radius: _Positive = CLAMP_RADIUS_M
    density: _Positive = 1000.0
    fruit_density: _Positive = 850.0
    contact_stiffness: _Positive = 2000.0
    capture_range: _Positive = 0.02
    limits: tuple[LimbLimits, ...] = ()

    @model_validator(mode="after")
    def _is_interval(self) -> Wood:
        _check_interval(self.youngs_modulus_gpa)
        return self

    def of(self, name: str) -> Wood:
        """The wood with the limits of one limb or fruit."""
        given = [each.given for each in self.limits if each.is_for(name)]
        return self.copy_unchecked({key: value for each in given for key, value in each.items()}) if given else self

    def unknown_limits(self, names: Collection[str]) -> tuple[int, str] | None:
        """The first of `limits`, and its name, that is for none of some limbs and fruit; None without any."""
        for number, each in enumerate(self.limits):
            for pattern in each.names:
                if not any(fnmatchcase(name, pattern) for name in names):
                    return number, pattern
        return None

    @property
    def wood_stress(self) -> float:
        """Maximum bending stress [Pa]."""
        return 1e6 * self.wood_stress_mpa

    @property
    def stiffest(self) -> float:
        """Maximum of Young's modulus [Pa]."""
        return 1e9 * self.youngs_modulus_gpa[1]

    @property
    def softest(self) -> float:
        """Minimum of Young's modulus [Pa]."""
        return 1e9 * self.youngs_modulus_gpa[0]

    def scale(self, share: float) -> Wood:
        """The same wood with a fraction of the limits of force and stress."""
        scaled = {key: share * getattr(self, key) for key in _LIMITS}
        scaled["limits"] = tuple(
            each.with_values(**{key: share * value for key, value in each.given.items() if key in _LIMITS})
            for each in self.limits
        )
        return self.with_values(**scaled)

    @property
    def as_rigid(self) -> Wood:
        """The same wood with limits within which no limb yields."""
        return self.scale(_NOTHING)


#: Fraction of the limits within which no limb yields.
_NOTHING: Final = 1e-9


class SegmentLimits(NamedTuple):
    """Limits and properties by limb segment.

    Attributes:
        force: (n,) maximum force on it [N].
        stress: (n,) maximum bending stress of all segments on its path to the clamp [Pa].
        softest: (n,) minimum of Young's modulus [Pa].
        stiffest: (n,) maximum of Young's modulus [Pa].
    """

    force: FloatArray
    stress: FloatArray
    softest: FloatArray
    stiffest: FloatArray


@lru_cache(maxsize=8)
def limits_by_segment(limbs: Limbs, wood: Wood) -> SegmentLimits:
    """Limits and properties of each limb segment.

    Raises:
        SceneError: Segments of one limb differ in Young's modulus.
    """
    each = [wood.of(name) for name in limbs.names] if wood.limits else [wood] * len(limbs.names)
    force, stress, softest, stiffest = (
        np.array([getattr(one, key) for one in each], dtype=np.float64)
        for key in ("contact_force", "wood_stress", "softest", "stiffest")
    )
    for row in limbs.order.tolist() if wood.limits else ():
        on = int(limbs.parent[row])
        if on < 0 or limbs.clamped[row] or limbs.clamped[on]:
            continue
        stress[row] = min(stress[row], stress[on])
        if (softest[row], stiffest[row]) != (softest[on], stiffest[on]):
            reason = f"{limbs.names[row]!r} and {limbs.names[on]!r} are one limb, which has one Young's modulus"
            raise SceneError(reason, where="wood.limits", value=each[row].youngs_modulus_gpa)
    return SegmentLimits(force, stress, softest, stiffest)
