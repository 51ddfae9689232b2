"""What `import hplan` offers."""

from __future__ import annotations

import importlib

import pytest

import hplan


@pytest.mark.parametrize("name", hplan.__all__)
def test_public_names_load(name: str) -> None:
    value = getattr(hplan, name)
    home = importlib.import_module(value.__module__)
    assert home.__name__.startswith("hplan.")
    assert getattr(home, name) is value
    assert value.__doc__


def test_public_names_are_listed() -> None:
    assert dir(hplan) == sorted(hplan.__all__)


def test_unknown_name() -> None:
    with pytest.raises(AttributeError, match="has no attribute 'plann'"):
        hplan.plann  # noqa: B018


def test_all_errors_have_one_root() -> None:
    errors = importlib.import_module("hplan.errors")
    kinds = [kind for kind in vars(errors).values() if isinstance(kind, type) and issubclass(kind, Exception)]
    assert len(kinds) > 8
    assert all(issubclass(kind, hplan.HplanError) for kind in kinds)
    assert {kind.exit_status for kind in kinds} == {1, 2, 3, 4, 5, 6}
