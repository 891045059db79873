"""Contracts: what is read, and one line for everything that is wrong with one."""

import pytest

from diffbot_bag.bounded_yaml import load_yaml
from diffbot_bag.tools.contract import MAX_BYTES, read_contract
from diffbot_core.errors import DiffbotError


@pytest.fixture
def contract(tmp_path):
    def read(text):
        path = tmp_path / "contract.yaml"
        path.write_text(text, encoding="utf-8")
        return read_contract(path)

    return read


def test_only_the_rules_that_are_named_are_checked(contract):
    found = contract(
        "version: 1\nbag: {max_lost: 3}\ntopics:\n  /odom: {max_rate: 11, min_rate: 9}\n  /a/b:\nforbidden: [/raw]\n"
    )
    assert found.bag.names == ("max_lost",)
    assert found.bag.rules.max_lost == 3
    assert found.topics["/odom"].names == ("min_rate", "max_rate")
    assert found.topics["/odom"].rules.max_rate == 11.0
    assert found.topics["/a/b"].names == ()
    assert found.forbidden == ("/raw",)


WRONG = {
    "no map": ("[1]", "the contract = [1]: must be a map"),
    "no version": ("topics: {}", "version = None: must be 1"),
    "a truth for a version": ("version: true", "version = True: must be 1"),
    "unknown section": ("version: 1\ntopic: {}", "'topic' is unknown: must be one of version, bag, topics, forbidden"),
    "unknown rule": ("version: 1\ntopics: {/a: {min_rat: 1}}", "/a: 'min_rat' is unknown: must be one of required, "),
    "a field's method": ("version: 1\nbag: {check: 1}", "bag: 'check' is unknown"),
    "negative rate": ("version: 1\ntopics: {/a: {min_rate: -1}}", "/a: min_rate = -1.0: must be >= 0 and <= 1e+10"),
    "nan": (
        "version: 1\ntopics: {/a: {max_gap: .nan}}",
        "/a: max_gap = nan: must be >= 0 and <= 1e+10 (inf: no limit)",
    ),
    "a text for a number": ("version: 1\ntopics: {/a: {max_gap: x}}", "/a: max_gap = 'x': must be a number"),
    "half a message": ("version: 1\ntopics: {/a: {max_lost: 0.5}}", "max_lost = 0.5: must be a whole number"),
    "a number for a truth": ("version: 1\ntopics: {/a: {stamped: 1}}", "stamped = 1: must be true or false"),
    "a share": ("version: 1\ntopics: {/a: {min_white: 1.5}}", "min_white = 1.5: must be >= 0 and <= 1"),
    "a policy": ("version: 1\ntopics: {/a: {reliability: good}}", "reliability = 'good': must be one of reliable"),
    "bounds that cross": (
        "version: 1\ntopics: {/a: {min_rate: 2, max_rate: 1}}",
        "/a: min_rate = 2.0: must be <= max_rate = 1.0",
    ),
    "a relative name": ("version: 1\ntopics: {odom: {}}", "topics: 'odom': must be the full name of a topic"),
    "a name of two lines": ('version: 1\nforbidden: ["/a\\nb"]', "must be the full name of a topic"),
    "forbidden as a map": ("version: 1\nforbidden: {/a: 1}", "must be a list of topics"),
    "required and forbidden": ("version: 1\ntopics: {/a: {}}\nforbidden: [/a]", "must be in one of them"),
    "a topic twice": ("version: 1\ntopics:\n  /a: {}\n  /a: {}", "'/a' stands there twice"),
    "a rule twice": ("version: 1\ntopics: {/a: {max_gap: 1, max_gap: 9}}", "'max_gap' stands there twice"),
    "a tag": ("!!python/object/apply:os.system [ls]", "is not a YAML file"),
    "a long value": (f"version: 1\ntopics: {{/a: {{type: {'x' * 999}}}}}", "has a value of 1001 characters"),
    "a huge number": (f"version: 1\nbag: {{max_lost: {10**50}}}", "must be >= 0 and <= "),
    "too large": (" " * (MAX_BYTES + 1), "is too large"),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_is_wrong_is_refused_in_one_line(contract, name):
    text, expected = WRONG[name]
    with pytest.raises(DiffbotError) as error:
        contract(text)
    assert expected in str(error.value)
    assert "contract.yaml" in str(error.value)
    assert str(error.value).isprintable()
    assert len(str(error.value)) < 700


def test_a_contract_that_is_not_there(tmp_path):
    with pytest.raises(DiffbotError, match=r"cannot open .*none\.yaml: No such file"):
        read_contract(tmp_path / "none.yaml")
    # Metadata of others may have a key twice.
    assert load_yaml("{a: 1, a: 2}", "metadata") == {"a": 2}
