"""The arm among random discs: the two levels say "no path" exactly when the dense search does."""

from __future__ import annotations

from studies.paper.random_scenes import compare


def test_two_level_agrees_with_dense_on_random_scenes() -> None:
    outcome = compare(80, seed=7)
    assert outcome.disagree == 0
    assert 45 < outcome.with_path < 80
    assert outcome.fallbacks["none"] > 0.9 * outcome.with_path
    assert outcome.ratio_median < 1.001
    assert outcome.ratio_worst < 1.6
