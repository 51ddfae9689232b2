from __future__ import annotations

import math
from dataclasses import replace

import pinocchio as pin
import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hplan.base.data_files import urdf_dir
from hplan.certificate.digests import robot_digest
from hplan.errors import OptionError
from hplan.robot.base_shapes import turning_shapes
from hplan.robot.family import HARVESTER, ORCHARD_HARVESTER, ArmSpec, cross_check, write_robot
from hplan.robot.model import load_robot

URDF = urdf_dir() / "harvester.urdf"


def arm(n: int, *, has_yaw: bool = True, name: str = "test_arm") -> ArmSpec:
    joints = n + has_yaw
    return ArmSpec(
        name=name,
        link_lengths=tuple(0.6 - 0.05 * i for i in range(n)),
        link_half_widths=(0.03,) * n,
        link_masses=(2.0,) * n,
        lower=(-1.0,) * joints,
        upper=(1.5,) * joints,
        velocity=(1.0,) * joints,
        effort=(200.0,) * joints,
        acceleration=(2.0,) * joints,
        has_yaw=has_yaw,
    )


# The shipped robot


@pytest.mark.parametrize("spec", [HARVESTER, ORCHARD_HARVESTER], ids=lambda spec: spec.name)
def test_shipped_robots_are_what_the_writer_writes(tmp_path, spec):
    """Inertia, joints, limits and what collides; what one sees of them is drawn."""
    written = load_robot(write_robot(spec, tmp_path / f"{spec.name}.urdf")[0])
    assert robot_digest(written) == robot_digest(load_robot(spec.name))
    seen, checked = written.visual_model.geometryObjects, written.collision_model.geometryObjects
    assert [shape.placement for shape in seen] == [shape.placement for shape in checked]


def test_shipped_robot_reads_alike_everywhere():
    check = cross_check(URDF)
    assert check.frames == ("base_link", "turret", "upper_arm", "forearm", "hand", "tool0")
    assert check.samples == 100
    assert check.max_position_deviation < 1e-12
    assert check.max_rotation_deviation < 1e-12
    assert check.limits_equal
    assert check.masses_equal


# The family


positive = st.floats(1e-3, 1e3)


@st.composite
def specs(draw: st.DrawFn) -> ArmSpec:
    n = draw(st.integers(1, 6))
    has_yaw = draw(st.booleans())

    def values(elements: st.SearchStrategy[float], count: int) -> list[float]:
        return draw(st.lists(elements, min_size=count, max_size=count))

    joints = n + has_yaw
    lower = values(st.floats(-3.0, 3.0), joints)
    return ArmSpec(
        name=draw(st.from_regex(r"[A-Za-z][A-Za-z0-9_]{0,8}", fullmatch=True)),
        link_lengths=tuple(values(st.floats(0.01, 10.0), n)),
        link_half_widths=tuple(values(st.floats(0.001, 1.0), n)),
        link_masses=tuple(values(positive, n)),
        lower=tuple(lower),
        upper=tuple(low + span for low, span in zip(lower, values(positive, joints), strict=True)),
        velocity=tuple(values(positive, joints)),
        effort=tuple(values(positive, joints)),
        acceleration=tuple(values(positive, joints)),
        jerk=draw(st.none() | st.just(tuple(values(positive, joints)))),
        shoulder_height=draw(st.floats(0.01, 3.0)),
        has_yaw=has_yaw,
        yaw_axis=tuple(values(st.floats(-2.0, 2.0), 2)),
        shoulder_offset=draw(st.floats(-0.5, 0.5)),
        link_offsets=draw(st.none() | st.just(tuple(values(st.floats(-0.3, 0.3), n)))),
    )


@settings(max_examples=15, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(spec=specs())
def test_any_spec_survives_the_files(spec, tmp_path):
    urdf, limits_path = write_robot(spec, tmp_path / "arm.urdf")
    model, collision_model, _ = pin.buildModelsFromUrdf(str(urdf))
    assert tuple(model.names)[1:] == spec.joint_names
    assert tuple(model.lowerPositionLimit) == spec.lower
    assert tuple(model.upperPositionLimit) == spec.upper
    assert tuple(model.velocityLimit) == spec.velocity
    assert tuple(model.effortLimit) == spec.effort
    for k, link in enumerate(spec.arm_link_names):
        shapes = [g.geometry for g in collision_model.geometryObjects if g.name[:-2] == link]
        side, *ends = shapes
        assert [sphere.radius for sphere in ends] == [spec.link_half_widths[k]] * 2
        assert side.radius == spec.link_half_widths[k]
        assert 2 * side.halfLength == spec.link_lengths[k]
    limits = yaml.safe_load(limits_path.read_text())
    assert tuple(limits["acceleration_rad_s2"]) == spec.joint_names
    assert tuple(limits["acceleration_rad_s2"].values()) == spec.acceleration
    if spec.jerk is not None:
        assert tuple(limits["jerk_rad_s3"].values()) == spec.jerk
    assert cross_check(urdf, samples=3).max_position_deviation < 1e-10


def test_offsets_are_read_as_they_were_written(tmp_path):
    spec = replace(HARVESTER, name="aside", yaw_axis=(0.3, -0.2), shoulder_offset=0.15, link_offsets=(0.06, -0.02, 0.0))
    robot = load_robot(write_robot(spec, tmp_path / "aside.urdf")[0])
    assert robot.yaw_axis.tolist() == [0.3, -0.2]
    assert robot.plane_origin == pytest.approx([0.3, -0.2 + 0.15, 0.6], abs=1e-15)
    assert robot.plane_axes.tolist() == [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    assert robot.shoulder_from_axis == pytest.approx((0.0, -0.15), abs=1e-15)
    assert robot.arm.lateral.tolist() == [-0.06, 0.02, 0.0]  # the plane's normal is -y
    assert robot.arm.half_widths == pytest.approx(HARVESTER.link_half_widths, rel=1e-9)
    (axle,) = turning_shapes(robot)  # the pedestal and the turret's body are round about the yaw axis
    assert axle.radius == pytest.approx(math.hypot(0.15 + 0.06, 0.8 * 0.05), rel=2e-3)


# Faults


@pytest.mark.parametrize(
    ("change", "option"),
    [
        ({"name": "a--b"}, "name"),
        ({"name": "a<b"}, "name"),
        ({"link_lengths": ()}, "link_lengths"),
        ({"link_lengths": (1.0, math.nan)}, "link_lengths[1]"),
        ({"link_lengths": (1.0, 0.0)}, "link_lengths[1]"),
        ({"link_lengths": (1.0, "x")}, "link_lengths[1]"),
        ({"link_half_widths": (0.1,)}, "link_half_widths"),
        ({"link_masses": (1.0, 1.0, 1.0)}, "link_masses"),
        ({"velocity": (1.0, 1.0)}, "velocity"),
        ({"effort": (1.0, math.inf, 1.0)}, "effort[1]"),
        ({"acceleration": (0.0, 1.0, 1.0)}, "acceleration[0]"),
        ({"jerk": (1.0, 1.0)}, "jerk"),
        ({"lower": (-1.0, 1.5, -1.0)}, "lower[joint_1]"),
        ({"upper": (-2.0, 1.5, 1.0)}, "lower[base_yaw]"),
        ({"upper": (math.nan, 1.5, 1.0)}, "upper[0]"),
        ({"turret_mass": None}, "turret_mass"),
        ({"yaw_axis": (0.1,)}, "yaw_axis"),
        ({"yaw_axis": (0.1, math.nan)}, "yaw_axis[1]"),
        ({"shoulder_offset": math.inf}, "shoulder_offset"),
        ({"link_offsets": (0.1,)}, "link_offsets"),
    ],
)
def test_bad_specs_name_the_field(change, option):
    with pytest.raises(OptionError) as caught:
        replace(arm(2), **change)
    assert caught.value.option == option
