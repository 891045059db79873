"""The page of ``make trust``: its shares, intervals and times."""

import trust_page


def test_the_page_has_shares_with_intervals_and_times_by_load():
    """Wilson's 95 % intervals of 2 of 2, 1 of 2 and 3 of 4, as R's binom.confint gives them."""
    runs = [
        {"busy": busy, "ok": ok, "passed": 9, "failed": 0, "failing": [], "seconds": seconds, "load": [1.0, 2.0]}
        for busy, ok, seconds in ((False, True, 10.0), (True, False, 30.0), (False, True, 20.0), (True, True, 50.0))
    ]
    content = {"commit": "abc", "date": "today", "cores": 2, "python": "3", "loops": 4, "planned": 4, "variables": []}
    lines = trust_page.page({**content, "runs": runs}).splitlines()
    assert [line for line in lines if line.startswith("|")][2:] == [
        "| without busy loops | 2 | 2 | 34 to 100 % | 15 s | 20 s |",
        "| 4 busy loops | 2 | 1 | 9 to 91 % | 40 s | 50 s |",
        "| all | 4 | 3 | 30 to 95 % | 25 s | 50 s |",
    ]
