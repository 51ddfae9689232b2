"""Moving bodies in proof and planner: turret, masts, cabinets, folds, against coal."""

from __future__ import annotations

import math
from dataclasses import replace

import coal
import numpy as np
import pytest
from arm_variants import axis_points
from fitted_arms import Bodies, box, distance, fitted, mesh, quintic, scene_of
from studies.planar_cspace import joint_grid
from turret_shapes import bottom, placed_at, radius, turning_shapes

from hplan.certificate.certificate import certify
from hplan.collision.coal_scene import CoalScene
from hplan.collision.compiled_field import ClearanceField
from hplan.errors import ConfigurationInCollisionError, NoPathError
from hplan.geometry.hull import CUBE_CORNERS
from hplan.geometry.lipschitz import is_always_within, may_reach
from hplan.geometry.shape_outline import coal_distance
from hplan.planar.base_shapes import GROUND_CARRIER, TURRET, base_shapes
from hplan.planar.family_reader import family_of
from hplan.planar.grid.occupancy import occupancy
from hplan.planar.grid.prepared_obstacles import prepare_obstacles
from hplan.planar.grid.sections import sections_at
from hplan.planar.self_contact import self_contact
from hplan.planning.joint_ranges import RANGE_MARGIN
from hplan.planning.options import PlanOptions
from hplan.planning.plan import plan
from hplan.planning.specialist import joint_ranges
from hplan.planning.world import World
from hplan.scene.obstacles import Box, Capsule, Sphere

COUNTERWEIGHT = box((0.5, 0.1, 0.1), (-0.3, 0.0, 0.45))
REST = (0.0, 45.0, 45.0, 45.0)
FAR = (120.0, 45.0, 45.0, 45.0)
POST = Capsule(name="post", start=(0.0, -0.4, 0.3), end=(0.0, -0.4, 0.55), radius=0.05)


def shown(certificate) -> bool:
    """True if the clearance is certified, regardless of limits."""
    return not any("comes to" in violation for violation in certificate.violations)


def solids_of(obstacles):
    """Obstacles in coal, without hplan."""
    placed = []
    for obstacle in obstacles:
        if isinstance(obstacle, Capsule):
            a, b = np.array(obstacle.start), np.array(obstacle.end)
            assert abs((b - a)[:2]).max() == 0.0  # upright
            placed.append((coal.Capsule(obstacle.radius, (b - a)[2]), coal.Transform3s(np.eye(3), 0.5 * (a + b))))
        elif isinstance(obstacle, Sphere):
            placed.append((coal.Sphere(obstacle.radius), coal.Transform3s(np.eye(3), np.array(obstacle.center))))
        else:
            placed.append((coal.Box(*obstacle.size), coal.Transform3s(obstacle.rotation, np.array(obstacle.center))))
    return placed


def own(robot, mover="", **made):
    """Names of the arm's self-pairs whose moving body has a string in its name."""
    pairs = CoalScene(robot, [], **made).parts.own
    return [(pair.mover_name, pair.other_name) for pair in pairs if mover in ("", pair.mover_name)]


def turret_radius(robot):
    """Maximum distance of the turret's moving bodies from the yaw axis [m]."""
    return max((radius(shape) for shape in turning_shapes(robot)), default=0.0)


# Turret and obstacles


@pytest.mark.parametrize("kind", ["box", "mesh"])
def test_counterweight_does_not_sweep_through_a_post(tmp_path, kind):
    corners = CUBE_CORNERS * (0.25, 0.05, 0.05)
    counterweight = COUNTERWEIGHT if kind == "box" else mesh(tmp_path / "weight.obj", corners, (-0.3, 0.0, 0.45))
    robot = fitted(tmp_path, {"turret": [counterweight]})
    bodies, solids = Bodies(robot), solids_of([POST])
    certificate = certify(robot, scene_of(REST, FAR, [POST]), quintic(robot, REST, FAR))
    assert not shown(certificate)
    assert (certificate.nearest.link, certificate.nearest.obstacle) == ("turret", "post")
    assert certificate.min_clearance_m < -0.08
    with pytest.raises(NoPathError, match="'turret' is in obstacle 'post'") as caught:
        plan(robot, scene_of(REST, FAR, [POST]))
    # The reported yaws are blocked, the adjacent ones are not.
    (blocker,) = caught.value.blockers
    low, high = blocker["slices_deg"]
    for yaw in np.linspace(0.0, 120.0, 481):
        inside = low + 0.05 < yaw < high - 0.05
        if inside or not low - 0.05 < yaw < high + 0.05:
            assert (bodies.clearance(np.radians([yaw, *REST[1:]]), solids) <= 0.0) == inside
    # On this side of it, all is as it was.
    near = (60.0, 45.0, 45.0, 45.0)
    result = plan(robot, scene_of(REST, near, [POST]))
    assert result.certificate.verified
    least = min(bodies.from_obstacles(q, solids) for q in result.trajectory.position[::4])
    assert least >= result.certificate.min_clearance_m > 0.0


def test_turns_are_taken_up_to_the_obstacle(tmp_path):
    """A goal a degree before the wall is reached, one behind it is not, and one in it is refused as such."""
    robot = fitted(tmp_path, {"turret": [COUNTERWEIGHT]})
    checker = CoalScene(robot, [POST])
    edge = math.degrees(joint_ranges(checker, np.radians(REST)).upper[0])
    assert 70.0 < edge < 80.0
    goal = (edge - 0.3, *REST[1:])
    result = plan(robot, scene_of(REST, goal, [POST]))
    assert result.certificate.verified
    assert result.problem.upper[0, 0] < math.radians(edge + 0.3)
    with pytest.raises(ConfigurationInCollisionError, match=r"'turret' is .* mm deep in obstacle 'post'"):
        plan(robot, scene_of(REST, (90.0, *REST[1:]), [POST]))
    with pytest.raises(ConfigurationInCollisionError, match=r"start.*'turret' is .* mm deep in obstacle 'post'"):
        plan(robot, scene_of((90.0, *REST[1:]), REST, [POST]))


@pytest.mark.parametrize("clearance", [0.0, 0.03])
@pytest.mark.parametrize("sigma", [0.0, 0.004])
def test_ranges_of_yaw_are_those_of_coal(tmp_path, clearance, sigma):
    rng = np.random.default_rng(3)
    carried = [box((0.4, 0.2, 0.1), (-0.3, 0.05, 0.45), (0.2, 0.1, 0.4)), box((0.1,) * 3, (0.1, 0.4, 0.5))]
    robot = fitted(tmp_path, {"turret": carried})
    bodies, walls = Bodies(robot), 0
    turning = [shape for shape in bodies.shapes if shape[0] == 1][1:]
    lowest = [bottom(shape) for shape in base_shapes(robot) if shape.carrier == TURRET][1:]
    for _ in range(12):
        obstacles = [
            Sphere(name=f"o{i}", center=(r * math.cos(a), r * math.sin(a), z), radius=0.06, sigma=sigma)
            for i, (r, a, z) in enumerate(rng.uniform([0.2, -3.1, 0.2], [0.7, 3.1, 0.7], (2, 3)))
        ]
        world = World.build(robot, obstacles, clearance=clearance, sigmas=2.0)

        def spare(yaw, obstacles=obstacles):
            found = [1.0]
            for (_, _, shape, placement), low in zip(turning, lowest, strict=True):
                where = coal.Transform3s(*_turned(yaw, placement))
                # Obstacles that are below the turret at all yaws are left out.
                reached = solids_of(o for o in obstacles if o.center[2] + o.radius + 2.0 * sigma > low)
                found += [distance(shape, where, *solid) for solid in reached]
            return min(found) - clearance - 2.0 * sigma

        start = np.zeros(4)
        if spare(0.0) < 0.01:
            continue
        ranges = joint_ranges(world.checker, start)
        for sign, end in ((-1.0, ranges.lower[0]), (1.0, ranges.upper[0])):
            assert min(spare(yaw) for yaw in np.linspace(0.0, end, 400)) >= 0.99 * RANGE_MARGIN
            if abs(end) < math.pi:
                walls += 1
                assert spare(end + sign * 2e-3) < 1.2 * RANGE_MARGIN
    assert walls > 6


def _turned(yaw, placement):
    turn = np.array([[math.cos(yaw), -math.sin(yaw), 0], [math.sin(yaw), math.cos(yaw), 0], [0, 0, 1.0]])
    return turn @ placement.rotation, turn @ placement.translation


def test_ground_is_below_at_all_yaws(tmp_path):
    """A counterweight may rest on the floor, and a box may turn above a table."""
    robot = fitted(tmp_path, {"turret": [box((0.5, 0.1, 0.2), (-0.3, 0.0, 0.1))]})
    floor = Box(name="floor", center=(0.0, 0.0, -0.05), size=(6.0, 6.0, 0.1))
    checker = CoalScene(robot, [floor], clearance=0.02)
    assert checker.distances(np.zeros(4))[checker.mover_names.index("turret"), 0] == np.inf
    assert checker.supported == (("turret", "floor"),)
    assert plan(robot, scene_of(REST, FAR, [floor])).certificate.verified
    kerb = Box(name="kerb", center=(0.0, 0.45, 0.0), size=(0.1, 0.1, 0.1))
    motion = quintic(robot, REST, (-170.0, *REST[1:]))
    assert not shown(certify(robot, scene_of(REST, FAR, [floor, kerb]), motion))
    assert shown(certify(robot, scene_of(REST, FAR, [floor]), motion))


def test_uncertain_height_counts_for_turret(tmp_path):
    """An obstacle 5 mm below it may be 9 mm higher; the supporting floor may not."""
    robot = fitted(tmp_path, {"turret": [box((0.5, 0.1, 0.2), (-0.3, 0.0, 0.1))]})
    lowest = next(bottom(shape) for shape in turning_shapes(robot))
    crate = Box(name="crate", center=(0.0, 0.3, lowest - 0.055), size=(0.1, 0.1, 0.1))
    floor = Box(name="floor", center=(0.0, 0.0, lowest - 0.05), size=(6.0, 6.0, 0.1))
    for growth in (0.0, 0.009):
        checker = CoalScene(robot, [crate, floor], growth=np.full(2, growth))
        distances = checker.distances([math.pi / 2, 0.0, 0.0, 0.0])[checker.mover_names.index("turret")]
        assert distances[0] == pytest.approx(0.005 - growth, abs=1e-6) or distances[0] > 0.05
        assert distances[1] == np.inf


@pytest.mark.parametrize("depth", [1e-4, 5e-4, 9e-4, -1e-3])
@pytest.mark.parametrize("kind", ["ball", "box"])
def test_obstacle_grazed_by_turret_from_above_blocks(tmp_path, kind, depth):
    """Even a small overlap: the turret does not rest on it, but turns into it."""
    robot = fitted(tmp_path, {"turret": [box((0.2, 0.1, 0.1), (-0.3, 0.0, 0.45))]})
    top = bottom(max((shape for shape in base_shapes(robot) if shape.carrier == TURRET), key=radius))
    top += depth
    obstacle = Sphere(name="kerb", center=(0.0, 0.3, top - 0.05), radius=0.05)
    if kind == "box":
        obstacle = Box(name="kerb", center=(0.0, 0.3, top - 0.05), size=(0.1, 0.1, 0.1))
    motion = quintic(robot, REST, (-170.0, *REST[1:]))
    assert bool(shown(certify(robot, scene_of(REST, FAR, [obstacle]), motion))) == (depth < 0.0)


def test_obstacle_of_turret_counts_with_its_uncertainty(tmp_path):
    robot = fitted(tmp_path, {"turret": [COUNTERWEIGHT]})
    ball = Sphere(name="ball", center=(0.0, 0.62, 0.45), radius=0.05, sigma=0.01)  # 20 mm from the sweep
    motion = quintic(robot, REST, (-170.0, *REST[1:]))
    bodies, solids = Bodies(robot), solids_of([ball])
    least = min(bodies.from_obstacles(q, solids) for q in motion.position)
    for sigmas, clearance, error, expected in (
        (0.0, 0.0, 0.0, True),
        (3.0, 0.0, 0.0, False),
        (0.0, least + 1e-4, 0.0, False),
        (0.0, 0.0, 1.1 * least / turret_radius(robot), False),
        (0.0, 0.0, 0.9 * least / turret_radius(robot), True),
    ):
        checker = CoalScene(robot, [ball], growth=sigmas * ball.sigma)
        certificate = certify(
            robot, scene_of(REST, obstacles=[ball], clearance=clearance), motion, tracking_error=error, checker=checker
        )
        assert shown(certificate) == expected
        if expected:
            assert clearance < certificate.min_clearance_m <= least - error * turret_radius(robot) + 1e-6


# Turret and pedestal


@pytest.mark.parametrize("kind", ["box", "mesh"])
def test_turret_and_pedestal_are_pairs_where_they_can_touch(tmp_path, kind):
    stop = box((0.1, 0.1, 0.3), (0.0, -0.4, 0.4))
    if kind == "mesh":
        # Rounder than the corners of a body can represent.
        turns = np.linspace(0.0, 2.0 * math.pi, 90, endpoint=False)
        ring = 0.05 * np.column_stack([np.cos(turns), np.sin(turns)])
        stop = mesh(tmp_path / "stop.obj", [(*at, z) for z in (0.25, 0.55) for at in ring], (0.0, -0.4, 0.0))
    robot = fitted(tmp_path, {"turret": [COUNTERWEIGHT], "base_link": [stop]})
    assert own(robot, "turret") == [("turret", "base_link")]
    certificate = certify(robot, scene_of(REST), quintic(robot, REST, FAR))
    assert not shown(certificate)
    assert (certificate.nearest.link, certificate.nearest.obstacle) == ("turret", "base_link")
    with pytest.raises(NoPathError, match="'turret' is in link 'base_link'"):
        plan(robot, scene_of(REST, FAR))
    result = plan(robot, scene_of(REST, (60.0, 45.0, 45.0, 45.0)))
    assert result.certificate.verified
    bodies = Bodies(robot)
    assert min(bodies.clearance(q) for q in result.trajectory.position[::4]) > 0.0


def test_turret_and_pedestal_that_always_or_never_touch_are_left_out(tmp_path):
    flange = box((0.2, 0.2, 0.1), (0.0, 0.0, 0.4))
    cases = {
        "mounted": ([box((0.3, 0.3, 0.1), (0.0, 0.0, 0.42))], [flange]),
        "resting on it": ([box((0.3, 0.3, 0.1), (0.0, 0.0, 0.5))], [flange]),
        "beside it": ([COUNTERWEIGHT], [box((0.1, 0.1, 0.5), (0.0, -0.8, 0.4))]),
    }
    for name, (turret, base) in cases.items():
        robot = fitted(tmp_path, {"turret": turret, "base_link": base}, name=name.replace(" ", "_"))
        assert own(robot, "turret") == [], name
    # Only within the limits: a stop at the back that the base never reaches.
    stop = box((0.1, 0.1, 0.3), (0.4, 0.0, 0.4))
    for yaw_deg, expected in ((180.0, 1), (100.0, 0), (166.0, 1)):
        robot = fitted(
            tmp_path, {"turret": [COUNTERWEIGHT], "base_link": [stop]}, yaw_deg=yaw_deg, name=f"yaw{yaw_deg:g}"
        )
        assert len(own(robot, "turret")) == expected
    # A tracking error brings them together.
    robot = fitted(tmp_path, {"turret": [COUNTERWEIGHT], "base_link": [stop]}, yaw_deg=157.0, name="nearly")
    turning, standing = base_shapes(robot)[-1], base_shapes(robot)[1]
    ends = (robot.lower[0], robot.upper[0])
    gap = min(
        coal_distance(turning.placed.geometry, placed_at(turning, yaw), standing.placed.geometry, standing.placement)
        for yaw in ends
    )
    assert 0.0 < gap < 0.05
    assert len(own(robot, "turret")) == 0
    assert len(own(robot, "turret", deviation=gap / 0.3)) == 1


def test_contact_at_all_yaws_and_at_any_yaw_are_certain():
    rng = np.random.default_rng(4)
    for _ in range(200):
        shift, low = rng.uniform(-3.0, 3.0, 2)
        high = low + rng.uniform(0.0, 4.0)
        level = float(rng.uniform(-1.2, 1.2))
        values = np.sin(np.linspace(low, high, 2001) + shift)
        wave = lambda x, shift=shift: math.sin(x + shift)  # noqa: E731
        if abs(values.min() - level) > 2e-4:
            assert may_reach(wave, low, high, 1.0, level) == (values.min() < level)
        if abs(values.max() - level) > 2e-4:
            assert is_always_within(wave, low, high, 1.0, level) == (values.max() < level)


# Links, turret and pedestal


def test_mast_on_turret_is_checked_against_every_link(tmp_path):
    mast = box((0.05, 0.05, 0.8), (0.3, 0.0, 1.2))
    robot = fitted(tmp_path, {"turret": [mast]})
    contact = self_contact(robot)
    assert [(body.carrier, body.links[0]) for body in contact.bodies] == [(TURRET, 0)]
    low, high = (0.0, 5.0, 0.0, 0.0), (0.0, 85.0, 0.0, 0.0)
    certificate = certify(robot, scene_of(low), quintic(robot, low, high))
    assert not shown(certificate)
    assert (certificate.nearest.link, certificate.nearest.obstacle) == ("upper_arm", "turret")
    with pytest.raises(NoPathError):
        plan(robot, scene_of(low, high, locked_joints=("base_yaw",)), PlanOptions(step_deg=3.0))
    # The mast turns with the arm: it is no nearer after a turn.
    checker, field = CoalScene(robot, []), ClearanceField.build(robot, [])
    for yaw in (-2.0, 0.7, 3.0):
        q = np.array([yaw, 0.1, 0.4, 0.2])
        assert checker.nearest_contact(q).distance_m == pytest.approx(
            checker.nearest_contact([0.0, *q[1:]]).distance_m, abs=1e-9
        )
        assert field.spare_clearance(q) == pytest.approx(field.spare_clearance([0.0, *q[1:]]), abs=1e-12)
    result = plan(robot, scene_of((-100.0, 5.0, 0.0, 0.0), (100.0, 5.0, 80.0, 10.0)))
    assert result.certificate.verified
    bodies = Bodies(robot)
    assert min(bodies.clearance(q) for q in result.trajectory.position[::4]) > 0.0


def test_only_bodies_that_carry_the_shoulder_are_left_out(tmp_path):
    forks = [box((0.08, 0.011, 0.108), (0.0, y, 0.546)) for y in (-0.0365, 0.0365)]
    beside = box((0.1, 0.1, 0.3), (0.2, 0.0, 0.35))
    robot = fitted(tmp_path, {"turret": [*forks, beside]}, low=-60.0)
    assert {shape.number for shape in base_shapes(robot)} == {0, 1, 2, 3, 4}
    found = {body.number: body.links for body in self_contact(robot).bodies}
    assert 0 in found[4]
    assert all(0 not in found.get(shape, ()) for shape in (1, 2, 3))


def _fitted_arms(folder, rng, count):
    """Arms with boxes on pedestal and turret, masts, wide ranges."""
    for number in range(count):
        links = int(rng.integers(2, 4))
        more = {"turret": [], "base_link": []}
        for carrier, boxes in more.items():
            for _ in range(int(rng.integers(0, 3))):
                angle, r = rng.uniform(-math.pi, math.pi), rng.uniform(0.15, 0.5)
                top = 1.4 if carrier == "turret" else 0.6
                at = (r * math.cos(angle), r * math.sin(angle), rng.uniform(0.3, top))
                boxes.append(box(rng.uniform(0.04, 0.3, 3), at, rng.uniform(-1.0, 1.0, 3)))
        yield fitted(
            folder,
            more,
            low=-rng.uniform(0.0, 150.0, links),
            high=rng.uniform(40.0, 150.0, links),
            yaw_deg=float(rng.uniform(90.0, 300.0)) if rng.random() < 0.85 else None,
            lengths=rng.uniform(0.3, 1.0, links).round(3).tolist(),
            widths=np.sort(rng.uniform(0.02, 0.06, links))[::-1].round(3).tolist(),
            name=f"arm{number}",
        )


def test_distances_and_sections_of_base_bodies_agree_with_coal(tmp_path):
    rng = np.random.default_rng(21)
    near = {TURRET: 0, GROUND_CARRIER: 0}
    for robot in _fitted_arms(tmp_path, rng, 14):
        contact = self_contact(robot)
        bodies = [body for body in contact.bodies if not body.is_round]
        if not bodies:
            continue
        only_them = replace(contact, bodies=tuple(bodies), links=())
        checker = CoalScene(robot, [])
        of_links = {(link, body.number) for body in contact.bodies for link in body.links}
        known = {}
        for number, pair in enumerate(checker.parts.own):
            moved, still = pair.bodies
            if moved.name in family_of(robot).arm.link_names and still.shapes:
                key = family_of(robot).arm.link_names.index(moved.name), still.shapes[0]
                if key in of_links:
                    known[number] = key
        field = ClearanceField.build(robot, [])
        grid = joint_grid(family_of(robot).arm, math.radians(25.0))
        nodes = grid.coordinates(np.stack(np.unravel_index(np.arange(grid.size), grid.shape), axis=-1))
        yaws = rng.uniform(robot.lower[0], robot.upper[0], 2) if family_of(robot).has_yaw else [0.0]
        for yaw in yaws:
            sections = sections_at(robot, prepare_obstacles([]), float(yaw))
            ours = occupancy(family_of(robot).arm, sections, grid).occupied_mask.ravel()
            for node, occupied in zip(nodes, ours, strict=True):
                q = [yaw, *node] if family_of(robot).has_yaw else node
                every = checker.pair_distances(q)
                table = {body.number: [1.0] for body in bodies}
                for number, (link, shape) in known.items():
                    table.setdefault(shape, [1.0]).append(every[number])
                    if every[number] < -1e-6:
                        assert occupied, link
                least = float(every.min())
                if least > 0.05:
                    assert not occupied
                found = float(field.link_clearances(q, 100.0).min())
                if least > 1e-6:
                    assert -3e-3 + least <= found <= least + 1e-6
                else:
                    assert found <= 1e-6
                for body in only_them.bodies:
                    near[body.carrier] += min(table[body.number]) < 0.05
    assert min(near.values()) > 100


# Neighbours that fold


def test_neighbours_fold_up_to_the_convention(tmp_path):
    """From 19.5 degrees between them on; a wide elbow of 150 degrees folds into nothing."""
    wide = fitted(tmp_path, low=-150.0, high=150.0, name="wide")
    assert not {("forearm", "upper_arm"), ("hand", "forearm")} & set(own(wide))
    robot = fitted(tmp_path, low=0.0, high=(90.0, 178.0), lengths=(1.0, 0.7), widths=(0.05, 0.04), name="fold")
    assert (
        own(robot, "link_2").count(("link_2", "link_1")) == 2
    )  # the rest of either link is outside the joint's own zone
    low = math.pi - math.asin(1.0 / 3.0)
    goal = (0.0, 80.0, 177.0)
    with pytest.raises(ConfigurationInCollisionError, match=r"'link_2' is .* mm deep in link 'link_1'"):
        plan(robot, scene_of((0.0, 80.0, 60.0), goal))
    certificate = certify(robot, scene_of((0.0, 80.0, 60.0)), quintic(robot, (0.0, 80.0, 60.0), goal))
    assert not shown(certificate)
    assert (certificate.nearest.link, certificate.nearest.obstacle) == ("link_2", "link_1")
    result = plan(robot, scene_of((0.0, 80.0, 60.0), (0.0, 60.0, 159.0)))
    assert result.certificate.verified
    assert result.problem.upper[0, 2] < low
    assert result.problem.upper[0, 2] > low - 0.02


@pytest.mark.parametrize("aside", [0.0, 0.06])
@pytest.mark.parametrize("lengths", [(1.0, 0.7), (0.26, 0.7), (0.7, 0.26), (0.2, 0.8)])
def test_folded_angles_are_those_of_coal(tmp_path, lengths, aside):
    """For either order of lengths; the test itself trims the rest of the links."""
    beside = {"link_offsets": (0.0, aside)} if aside else {}
    robot = fitted(tmp_path, low=-179.0, high=(90.0, 179.0), lengths=lengths, widths=(0.05, 0.04), **beside)
    checker, reach = CoalScene(robot, []), 0.27
    folds = ("link_2", "link_1") in own(robot)
    assert folds == (max(lengths) > reach and min(lengths) > reach - math.sqrt(0.09**2 - aside**2))
    free = joint_ranges(checker, np.array([0.3, 0.4, 0.0]))
    for angle in np.radians(np.arange(-179.0, 180.0, 0.5)):
        points = axis_points(robot, np.array([0.3, 0.4, angle]))
        expected = math.inf
        for joint, end, other in ((points[1], points[2], points[0]), (points[1], points[0], points[2])):
            length = np.linalg.norm(end - joint)
            if length > reach:
                beyond = joint + (end - joint) * np.linspace(reach / length, 1.0, 60)[:, None]
                t = np.clip(((beyond - joint) @ (other - joint)) / ((other - joint) @ (other - joint)), 0.0, 1.0)
                in_plane = np.linalg.norm(beyond - joint - t[:, None] * (other - joint), axis=1).min()
                expected = min(expected, np.hypot(in_plane, aside) - 0.09)
        if folds:
            found = float(
                checker.distances([0.3, 0.4, angle])[
                    checker.mover_names.index("link_2"), checker.obstacle_names.index("link_1")
                ]
            )
            assert found == pytest.approx(expected, abs=1e-6)
            assert expected > 0.0 or not free.lower[2] < angle < free.upper[2]
            assert expected < 2.0 * RANGE_MARGIN or free.lower[2] < angle < free.upper[2]


def test_elbow_does_not_pass_through_its_fold(tmp_path):
    robot = fitted(tmp_path, low=0.0, high=(90.0, 300.0), lengths=(1.0, 0.7), widths=(0.05, 0.04))
    start, goal = (0.0, 60.0, 60.0), (0.0, 60.0, 260.0)
    with pytest.raises(NoPathError, match="'link_2' is in link 'link_1'") as caught:
        plan(robot, scene_of(start, goal))
    low, high = caught.value.blockers[0]["slices_deg"]
    assert (low, high) == (pytest.approx(160.5, abs=0.1), pytest.approx(199.5, abs=0.1))
    # A clearance enlarges the joint's own zone by the same amount: the angle is the same.
    with pytest.raises(NoPathError) as wider:
        plan(robot, scene_of(start, goal, clearance=0.03))
    assert wider.value.blockers[0]["slices_deg"] == pytest.approx((low, high), abs=0.2)
    with pytest.raises(NoPathError) as uncertain:
        plan(robot, scene_of(start, goal), PlanOptions(tracking_error=0.01))
    assert uncertain.value.blockers[0]["slices_deg"][0] < low - 0.5


# Limits, tracking error and clearance


def test_pairs_within_deviation_or_clearance_are_checked(tmp_path):
    """Two links that come to 1 mm of each other at their limits, and no nearer."""

    def arm(limit, name):
        return fitted(tmp_path, high=(85.0, 150.0, limit), name=name)

    def least(robot):
        planar = family_of(robot).arm.joint_points(
            np.column_stack([np.zeros(1501), elbows, np.full(1501, robot.upper[3])])
        )
        hand = planar[:, 2:3] + np.linspace(0.0, 1.0, 101)[:, None] * (planar[:, 3:] - planar[:, 2:3])
        apart = np.hypot(hand[..., 0] - np.clip(hand[..., 0], 0.0, 1.0), hand[..., 1]).min(axis=1) - 0.08
        return float(apart.min()), float(elbows[apart.argmin()])

    elbows = np.radians(np.linspace(0.0, 150.0, 1501))
    low, high = 60.0, 110.0
    for step in range(25):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if least(arm(middle, f"a{step}"))[0] > 1e-3 else (low, middle)
    robot = arm(low, "nearly")
    spare, elbow = least(robot)
    assert spare == pytest.approx(1e-3, abs=1e-4)
    assert self_contact(robot).links == ()
    end = np.degrees([0.0, math.radians(83.0), elbow, robot.upper[3]])
    motion = quintic(robot, end - [0.0, 0.0, 17.0, 17.0], end)
    for error, clearance, expected in ((0.0, 0.0, True), (0.5, 0.0, False), (0.0, 0.02, False), (0.01, 0.0, True)):
        certificate = certify(robot, scene_of(end, clearance=clearance), motion, tracking_error=math.radians(error))
        assert shown(certificate) == expected
    # For any obstacles of the coal scene.
    checker = CoalScene(robot, [])
    assert not shown(certify(robot, scene_of(end), motion, tracking_error=0.01, checker=checker))


# Random members


def test_certified_motions_of_random_arms_touch_nothing(tmp_path):
    """Coal finds no contact of the URDF's bodies in certified motions."""
    rng = np.random.default_rng(8)
    verified = {"any": 0, "turret": 0}
    refused = 0
    for robot in _fitted_arms(tmp_path, rng, 10):
        bodies = Bodies(robot)
        obstacles = [
            Sphere(name=f"o{i}", center=tuple(rng.uniform([-0.9, -0.9, 0.0], [0.9, 0.9, 1.2])), radius=0.05)
            for i in range(2)
        ]
        solids = solids_of(obstacles)
        for _ in range(6):
            start, end = np.degrees(rng.uniform(robot.lower, robot.upper, (2, robot.dof)))
            end = start + rng.uniform(0.2, 1.0) * (end - start)
            motion = quintic(robot, start, end)
            certificate = certify(robot, scene_of(start, obstacles=obstacles), motion)
            least = min(bodies.clearance(q, solids) for q in motion.position[::2])
            if shown(certificate):
                assert least > 0.0
                verified["any"] += 1
                verified["turret"] += turret_radius(robot) > 0.0
            else:
                refused += 1
    assert verified["turret"] > 5
    assert refused > 5


# Tools


def test_fixed_links_count_wherever_they_hang(tmp_path):
    shape = box((0.1, 0.1, 0.1), (0.0, 0.0, 0.0))
    hung = {
        "camera": ("upper_arm", (0.5, 0.0, 0.15), shape),
        "cabinet": ("base_link", (0.5, 0.0, 0.3), shape),
        "mast": ("turret", (0.0, 0.5, 0.3), shape),
    }
    robot = fitted(tmp_path, hung=hung)
    assert family_of(robot).arm.half_widths[0] == pytest.approx(math.hypot(0.2, 0.05))
    by_name = {base.name: base for base in base_shapes(robot)}
    assert {name: by_name[name].carrier for name in ("cabinet", "mast")} == {"cabinet": GROUND_CARRIER, "mast": TURRET}
    assert turret_radius(robot) == pytest.approx(math.hypot(0.05, 0.55))
    assert own(robot, "mast") == [("mast", "cabinet")]
    ball = Sphere(name="ball", center=(-0.5, 0.0, 0.3), radius=0.05)
    assert not shown(certify(robot, scene_of(REST, obstacles=[ball]), quintic(robot, (0, 0, 0, 0), (140, 0, 0, 0))))
