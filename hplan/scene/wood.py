"""Limits of force and stress for wood that bends, and the properties and assumptions that contacts are bounded with.

`hplan.scene.limb_contacts` turns them into solids with permitted depths.
"""

from __future__ import annotations

from typing import Annotated, Final

from pydantic import Field, model_validator

from hplan.base.checked import StrictModel, fault
from hplan.scene.limbs import CLAMP_RADIUS_M

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
        capture_range: Maximum displacement of the goal fruit at the grasp by the limbs that are pushed [m].

    Examples:
        >>> from hplan.scene import Wood
        >>> Wood(contact_force=5.0).youngs_modulus_gpa
        (0.7, 5.0)
    """

    contact_force: _Positive = 10.0
    wood_stress_mpa: _Positive = 30.0
    fruit_force: _Positive = 8.0
    youngs_modulus_gpa: tuple[_Positive, _Positive] = (0.7, 5.0)
    clamp_radius: _Positive = CLAMP_RADIUS_M
    density: _Positive = 1000.0
    fruit_density: _Positive = 850.0
    contact_stiffness: _Positive = 2000.0
    capture_range: _Positive = 0.02

    @model_validator(mode="after")
    def _is_interval(self) -> Wood:
        low, high = self.youngs_modulus_gpa
        if low > high:
            raise fault(f"expected the minimum first, got {low:g} and {high:g}", "youngs_modulus_gpa")
        return self

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
        limits = ("contact_force", "wood_stress_mpa", "fruit_force")
        return self.with_values(**{key: share * getattr(self, key) for key in limits})

    @property
    def as_rigid(self) -> Wood:
        """The same wood with limits within which no limb yields."""
        return self.scale(_NOTHING)


#: Fraction of the limits within which no limb yields.
_NOTHING: Final = 1e-9
