"""Each check of each scenario is a test: one session of Blender in a window, played once, gives many results."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from .session import Played, checks_of, scenarios

pytestmark = pytest.mark.timeout(900)  # the first test waits for its whole session, and for those played before it
CHECKS = [(scenario, check) for scenario in scenarios() for check in checks_of(scenario)]


@pytest.mark.parametrize(("scenario", "check"), CHECKS, ids=[f"{scenario}-{check}" for scenario, check in CHECKS])
def test_check(played: Callable[[str], Played], scenario: str, check: str) -> None:
    played(scenario).assert_passed(check)


@pytest.mark.parametrize("scenario", scenarios())
def test_it_ends_well_and_without_a_complaint(played: Callable[[str], Played], scenario: str) -> None:
    played(scenario).assert_quiet()


@pytest.mark.parametrize("scenario", ["extension"])
def test_it_is_driven_in_a_blender_in_support(played: Callable[[str], Played], scenario: str) -> None:
    """Not the version test of the command line: the one that really drew the windows."""
    version = played(scenario).version
    assert tuple(int(part) for part in version.split(" ")[0].split(".")[:2]) >= (4, 2), version
