"""In which entries two configurations differ, in words."""

from baselines.training.other_settings import MOST_SHOWN, words_of_difference


def test_only_entries_that_differ_are_named_with_both_values() -> None:
    old = {"seed": 1, "steps": 10, "method": {"rate": 0.1, "batch": 8, "inner": {"a": 1}}}
    new = {"seed": 2, "steps": 10, "method": {"rate": 0.1, "batch": 16, "inner": {"a": 1}}}
    assert words_of_difference(old, new) == "method.batch: 8 there, 16 here; seed: 1 there, 2 here"


def test_an_entry_that_one_does_not_have_is_named() -> None:
    assert words_of_difference({"a": {"b": 1}}, {"a": {"c": None}}) == (
        "a.b: 1 there, nothing here; a.c: nothing there, null here"
    )


def test_beyond_the_first_few_only_their_number_is_said() -> None:
    names = [f"entry{k:02d}" for k in range(MOST_SHOWN + 3)]
    words = words_of_difference(dict.fromkeys(names, 0), dict.fromkeys(names, 1))
    assert words.count("there") == MOST_SHOWN
    assert words.endswith("; and 3 more")
    exact = words_of_difference(
        dict.fromkeys(names[:MOST_SHOWN], 0), dict.fromkeys(names[:MOST_SHOWN], 1)
    )
    assert exact.endswith(f"entry{MOST_SHOWN - 1:02d}: 0 there, 1 here")


def test_a_long_value_is_cut() -> None:
    words = words_of_difference({"sensors": ["carbody"] * 50}, {"sensors": []})
    assert words == 'sensors: ["carbody", "carbody"... there, [] here'
