"""Each goal that is accepted ends exactly once, whatever happens to it."""

import math

import pytest

from diffbot_control.goals.goal_record import REPLACED, GoalBook, GoalRequest, time_remaining


def test_a_book_knows_its_goals_by_their_ids_and_forgets_the_oldest():
    book = GoalBook()
    for number in range(40):
        book.close(REPLACED)
        book.accept(GoalRequest(str(number)))
    assert book.find("39") is book.present
    assert book.find("38").end == REPLACED
    assert book.find("7").end == REPLACED
    assert book.find("6") is None
    assert GoalBook().find("") is None
    book.accept(GoalRequest())
    assert book.find("") is None, "a goal without an id cannot be asked for"


def test_time_remaining_begins_with_the_limit_and_goes_on_with_the_mean_speed():
    assert time_remaining(4.0, 4.0, 0.0, 0.5) == pytest.approx(8.0)
    assert time_remaining(3.9, 4.0, 10.0, 0.5) == pytest.approx(7.8), "too early for a mean"
    assert time_remaining(1.0, 4.0, 6.0, 0.5) == pytest.approx(2.0), "3 m in 6 s"
    assert time_remaining(0.0, 4.0, 6.0, 0.5) == 0.0
    assert time_remaining(4.0, 4.0, 0.0, math.inf) == 0.0
