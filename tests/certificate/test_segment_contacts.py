"""Tables of contacts beside plain loops over single contacts."""

from __future__ import annotations

from collections import defaultdict

import numpy as np
import pytest

from hplan.certificate.limb_loads import gentle_speeds
from hplan.certificate.segment_contacts import CONTACT, Push, SegmentContacts
from hplan.scene.obstacle_kind import ContactLimit

LINKS, OBSTACLES = ("hand", "forearm"), ("branch 2", "branch 1", "apple", "wire")


def random_contacts(seed: int, count: int = 300, first_limit: int = 0) -> SegmentContacts:
    """Contacts with parts of two branches, an apple and a wire, within segments of 0.1 s."""
    random = np.random.default_rng(seed)
    limits = [
        ContactLimit(
            0.02, *random.uniform([1.0, 1e6], [8.0, 2e7]), int(random.integers(4)), int(random.integers(-1, 2)),
            (0.0, 0.1), 4.0, 6e6, 3.0 if n % 3 == 2 else 0.0, 500.0, float(random.uniform(4.0, 8.0)), 2e7,
            None, 0.0, 0.02, 0.0, 0.2 if n % 3 == 2 else 0.0,
        )
        for n in range(first_limit, first_limit + 6)
    ]  # fmt: skip
    rows = np.zeros(count, CONTACT)
    rows["limit"] = random.integers(-1, len(limits), count)
    rows["obstacle"] = np.where(rows["limit"] < 0, 3, rows["limit"] % 3)
    rows["link"], rows["joint"] = random.integers(0, 2, count), 3
    begin = random.integers(0, 20, count)
    rows["begin_s"], rows["end_s"] = 0.1 * begin, 0.1 * (begin + 1)
    rows["share"], rows["depth"], rows["speed"] = random.uniform(0.0, [[1.0], [0.02], [0.7]], (3, count))
    return SegmentContacts(rows, LINKS, OBSTACLES, limits)


def limit_of(contacts: SegmentContacts, row: int) -> ContactLimit:
    limit = contacts.limits[int(contacts.rows["limit"][row])]
    assert limit is not None
    return limit


def force_and_impact(contacts: SegmentContacts, row: int) -> tuple[float, float]:
    """Static force of a contact, and that of its speed [N]."""
    limit, (share, speed) = limit_of(contacts, row), (float(contacts.rows[key][row]) for key in ("share", "speed"))
    return share * limit.force, limit.impact * speed + limit.swing * speed**2


@pytest.mark.parametrize("seed", range(4))
def test_loads_are_those_of_single_contacts(seed: int) -> None:
    contacts = random_contacts(seed)
    loads = contacts.loads
    assert loads.row.tolist() == [row for row in range(len(contacts)) if contacts.rows["limit"][row] >= 0]
    for number, row in enumerate(loads.row.tolist()):
        static, impact = force_and_impact(contacts, row)
        assert loads.force[number] == pytest.approx(static + impact)
        assert loads.static[number] == pytest.approx(static)
        assert loads.stress[number] == pytest.approx(contacts.rows["share"][row] * limit_of(contacts, row).stress)


def stresses_by_loops(contacts: SegmentContacts) -> dict[tuple[float, int], tuple[float, float]]:
    """Stress and impact stress of each root and time [Pa]."""
    parts: dict[tuple[float, int], dict[tuple[int, bool], float]] = defaultdict(lambda: defaultdict(float))
    impacts: dict[tuple[float, int], float] = defaultdict(float)
    for row, contact in enumerate(contacts.rows):
        if contact["limit"] < 0 or (limit := limit_of(contacts, row)).root < 0:
            continue
        key, part = (float(contact["begin_s"]), limit.root), (limit.segment, limit.swing > 0.0)
        parts[key][part] = max(parts[key][part], float(contact["share"]) * limit.stress)
        impacts[key] = max(impacts[key], float(contact["speed"]) * limit.impact_stress)
    return {key: (sum(part.values()) + impacts[key], impacts[key]) for key, part in parts.items()}


@pytest.mark.parametrize("seed", range(4))
def test_stresses_are_those_of_loops(seed: int) -> None:
    contacts = random_contacts(seed)
    stresses, expected = contacts.stresses, stresses_by_loops(contacts)
    assert len(stresses.first) == len(expected)
    for number in range(len(stresses.first)):
        members = stresses.loads(number)
        keys = {(float(contacts.rows["begin_s"][contacts.loads.row[n]]), int(contacts.loads.root[n])) for n in members}
        (key,) = keys
        assert (stresses.stress[number], stresses.impact[number]) == pytest.approx(expected[key])


@pytest.mark.parametrize("seed", range(4))
def test_speeds_are_those_of_loops(seed: int) -> None:
    contacts = random_contacts(seed, count=12)
    slower = list[tuple[float, float, float]]()
    for row, contact in enumerate(contacts.rows):
        if contact["limit"] >= 0:
            limit, (static, impact) = limit_of(contacts, row), force_and_impact(contacts, row)
            if static + impact > limit.most_force:
                fraction = (limit.most_force - static) / impact
                slower.append((contact["begin_s"], contact["end_s"], fraction ** (0.5 if limit.swing else 1.0)))
    for (begin_s, _), (stress, impact) in stresses_by_loops(contacts).items():
        if stress > 2e7:
            slower.append((begin_s, begin_s + 0.1, max(0.0, (2e7 - stress + impact) / impact)))
    found = gentle_speeds(contacts, 2.0, 0.05)
    if not slower or min(fraction for *_, fraction in slower) < 0.1:
        assert found is None
        return
    assert found is not None
    for time_s, speed in found:
        near = [fraction for begin, end, fraction in slower if begin - 0.05 <= time_s <= end + 0.05]
        assert speed == pytest.approx(min((0.93 * fraction for fraction in near), default=1.0))


def merged_by_loops(contacts: SegmentContacts) -> list[Push]:
    """Contacts of a link and obstacle without a gap between, as one."""
    found = list[Push]()
    order = sorted(range(len(contacts)), key=lambda row: (
        contacts.link(row), contacts.obstacle(row), contacts.rows["begin_s"][row],
    ))  # fmt: skip
    for row in order:
        contact, names = contacts.rows[row], (contacts.link(row), contacts.obstacle(row))
        begin, end, depth = (float(contact[key]) for key in ("begin_s", "end_s", "depth"))
        known = found[-1] if found else None
        load, stress = None, None
        if contact["limit"] >= 0:
            load, limit = sum(force_and_impact(contacts, row)), limit_of(contacts, row)
            stress = 1e-6 * float(contact["share"] * limit.stress + contact["speed"] * limit.impact_stress)
        if known is not None and (known.link, known.obstacle) == names and begin <= known.end_s:
            pairs = ((known.force_n, load), (known.stress_mpa, stress))
            most = [max((each for each in pair if each is not None), default=None) for pair in pairs]
            found[-1] = Push(*names, max(known.depth_m, depth), known.begin_s, max(known.end_s, end), *most)
        else:
            found.append(Push(*names, depth, begin, end, load, stress))
    return sorted(found, key=lambda push: push.begin_s)


@pytest.mark.parametrize("seed", range(6))
def test_merged_contacts_are_those_of_loops(seed: int) -> None:
    contacts = random_contacts(seed, count=(300, 60, 30, 12, 1, 0)[seed])
    found, expected = contacts.merged, merged_by_loops(contacts)
    assert len(found) == len(expected)
    for one, other in zip(found, expected, strict=True):
        assert vars(one) == pytest.approx(vars(other))


def described(contacts: SegmentContacts) -> list[tuple[object, ...]]:
    """Contacts by the names and limits that they have."""
    return [
        (
            contacts.link(row), contacts.obstacle(row), None if contact["limit"] < 0 else limit_of(contacts, row),
            *(float(contact[key]) for key in ("depth", "begin_s", "end_s", "share", "speed")),
        )
        for row, contact in enumerate(contacts.rows)
    ]  # fmt: skip


def test_joined_contacts_keep_names_and_limits() -> None:
    one, other = random_contacts(0), random_contacts(1, first_limit=6)
    renamed = SegmentContacts(other.rows, ("forearm", "tool"), ("apple", "wire", "post", "net"), other.limits)
    joined = SegmentContacts.join([one, SegmentContacts.none(), renamed.shift(2.0)])
    assert described(joined) == described(one) + described(renamed.shift(2.0))
    assert len(joined.limits) <= 12


def test_contacts_of_a_motion_in_reverse() -> None:
    contacts = random_contacts(2)
    found = contacts.shift(5.0, reversed_after_s=2.0)
    np.testing.assert_allclose(found.rows["begin_s"], 5.0 + 2.0 - contacts.rows["end_s"])
    np.testing.assert_allclose(found.rows["end_s"], 5.0 + 2.0 - contacts.rows["begin_s"])
