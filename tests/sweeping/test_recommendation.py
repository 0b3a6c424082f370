"""Fronts made by hand: which settings are on them, and which is taken."""

from __future__ import annotations

import pytest

from workbench.sweeping.recommendation import (
    Budget,
    Candidate,
    NoChoice,
    pareto_indices,
    recommended,
    relative_spread,
)

# Error, seconds: each twice as fine as the one before; the last is beaten.
FRONT = [Candidate(8.0, 1.0), Candidate(2.0, 2.0), Candidate(1.5, 8.0), Candidate(2.5, 9.0)]


def test_the_front_is_what_nothing_beats():
    assert pareto_indices(FRONT) == (0, 1, 2)
    # Of twins both are kept; a tie in one number loses against less in the other.
    twins = [Candidate(1.0, 2.0), Candidate(1.0, 2.0), Candidate(1.0, 3.0), Candidate(1.5, 2.0)]
    assert pareto_indices(twins) == (0, 1)
    assert pareto_indices([]) == ()


@pytest.mark.parametrize(
    ("budget", "index", "how"),
    [
        (Budget(), 1, "knee"),
        (Budget(error=2.2), 1, "error budget"),
        (Budget(error=1.5), 2, "error budget"),
        (Budget(error=100.0), 0, "error budget"),
        (Budget(seconds=1.5), 0, "time budget"),
        (Budget(seconds=100.0), 2, "time budget"),
        (Budget(error=2.0, seconds=3.0), 1, "error budget"),
    ],
)
def test_budgets_choose_on_the_front(budget: Budget, index: int, how: str):
    choice = recommended(FRONT, budget)
    assert choice
    assert (choice.index, choice.how) == (index, how)


@pytest.mark.parametrize(
    ("budget", "nearest", "words"),
    [
        (Budget(error=1.0), 2, "least: 1.5"),
        (Budget(seconds=0.5), 0, "quickest: 1 s"),
        (Budget(error=1.6, seconds=3.0), 1, "within 3 s"),
    ],
)
def test_what_no_setting_keeps_is_said_with_the_nearest(budget, nearest, words):
    choice = recommended(FRONT, budget)
    assert isinstance(choice, NoChoice)
    assert not choice
    assert choice.nearest == nearest
    assert words in choice.reason


def test_nothing_measured_and_one_measured():
    assert not recommended([], Budget())
    alone = recommended([Candidate(3.0, 4.0)], Budget())
    assert alone.index == 0
    assert "no other setting" in alone.reason


def test_times_within_the_noise_are_the_same_and_the_setting_in_force_wins():
    alike = [Candidate(1.0, 1.00), Candidate(1.0, 1.04, default=True), Candidate(0.9, 1.15)]
    assert recommended(alike, Budget(error=2.0), noise=0.0).index == 0
    assert recommended(alike, Budget(error=2.0), noise=0.05).index == 1
    # Of times alike, less error is better than being the default.
    assert recommended(alike, Budget(error=2.0), noise=0.2).index == 2


def test_the_spread_is_of_the_middle():
    assert relative_spread([5.0]) == 0.0
    assert relative_spread([1.0, 1.0, 100.0]) == 0.0
    assert relative_spread([0.9, 1.0, 1.1]) == pytest.approx(0.1)
