"""Typed settings and the checks of single values: what is converted, what is refused, and how."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import numpy as np
import pytest

from railenv.config import config_path, from_mapping, load_toml, to_dict
from railenv.errors import (
    ArgumentError,
    InputFileError,
    check_count,
    check_finite,
    check_not_negative,
    check_positive,
    check_text,
    unknown_name,
)


@dataclass(frozen=True)
class Inner:
    gain: float
    name: str = "inner"


@dataclass(frozen=True)
class Outer:
    count: int
    length: float
    active: bool = False
    period: Annotated[float, "s"] = 0.01
    limit: float | None = None
    speeds: tuple[float, ...] = ()
    inner: Inner = field(default_factory=lambda: Inner(1.0))
    parts: tuple[Inner, ...] = ()


def made(**entries: object) -> Outer:
    return from_mapping(Outer, {"count": 1, "length": 2.0, **entries}, "test")


def test_a_whole_number_for_a_float_becomes_a_float() -> None:
    assert isinstance(made(length=3).length, float)


def test_a_whole_number_for_an_annotated_float_becomes_a_float() -> None:
    assert isinstance(made(period=1).period, float)


def test_defaults_fill_what_is_not_given() -> None:
    assert made() == Outer(1, 2.0)


@pytest.mark.parametrize(
    ("entries", "message"),
    [
        ({"count": True}, r"test: count = True must be of type int"),
        ({"count": 1.0}, r"test: count = 1\.0 must be of type int"),
        ({"count": "1"}, r"test: count = '1' must be of type int"),
        ({"length": True}, r"test: length = True must be of type float"),
        ({"length": "2"}, r"test: length = '2' must be of type float"),
        ({"length": None}, r"test: length = None must be of type float"),
        ({"period": False}, r"test: period = False must be of type float"),
        ({"period": "1"}, r"test: period = '1' must be of type float"),
        ({"active": 1}, r"test: active = 1 must be of type bool"),
        ({"limit": True}, r"test: limit = True fits none of"),
        ({"limit": "none"}, r"test: limit = 'none' fits none of"),
        ({"speeds": 3.0}, r"test: speeds = 3\.0 must be a list"),
        ({"speeds": "12"}, r"test: speeds = '12' must be a list"),
        ({"speeds": [1.0, True]}, r"test: speeds\[1\] = True must be of type float"),
        ({"inner": 5.0}, r"test: inner = 5\.0 must be of type Inner"),
        ({"inner": {"gain": "x"}}, r"test: inner: gain = 'x' must be of type float"),
        ({"parts": [{"gain": 1}, {"gain": False}]}, r"test: parts\[1\]: gain = False must be"),
    ],
)
def test_a_wrong_type_is_refused_by_its_place(entries: dict, message: str) -> None:
    with pytest.raises(ArgumentError, match=message):
        made(**entries)


def test_a_list_becomes_a_tuple_of_converted_items() -> None:
    found = made(speeds=[1, 2.5]).speeds
    assert found == (1.0, 2.5)
    assert [type(value) for value in found] == [float, float]


@pytest.mark.parametrize(("given", "kept"), [(None, None), (4, 4.0), (2.5, 2.5)])
def test_an_optional_number_may_be_none_or_a_number(given: object, kept: object) -> None:
    found = made(limit=given).limit
    assert (found, type(found)) == (kept, type(kept))


def test_a_nested_mapping_becomes_the_nested_dataclass() -> None:
    assert made(inner={"gain": 5}).inner == Inner(5.0)


def test_a_list_of_mappings_becomes_a_tuple_of_dataclasses() -> None:
    assert made(parts=[{"gain": 1}, {"gain": 2, "name": "b"}]).parts == (
        Inner(1.0),
        Inner(2.0, "b"),
    )


def test_a_dataclass_that_is_built_already_is_kept() -> None:
    assert made(inner=Inner(7.0)).inner == Inner(7.0)


def test_every_missing_key_is_named_and_no_other() -> None:
    with pytest.raises(ArgumentError, match=r"^test: missing count, length; every one must") as e:
        from_mapping(Outer, {"active": True}, "test")
    assert "period" not in str(e.value)


def test_a_key_missing_inside_is_named_with_its_place() -> None:
    with pytest.raises(ArgumentError, match=r"test: inner: missing gain;"):
        made(inner={"name": "x"})


def test_an_unknown_key_is_refused_with_the_nearest_one() -> None:
    with pytest.raises(ArgumentError, match=r"test: unknown key 'lenght'; did you mean 'length'\?"):
        made(lenght=3.0)


def test_an_unknown_key_inside_is_refused_with_its_place() -> None:
    with pytest.raises(ArgumentError, match=r"test: inner: unknown key 'gian'; .*'gain'"):
        made(inner={"gain": 1.0, "gian": 2.0})


def test_only_a_dataclass_can_be_built() -> None:
    with pytest.raises(TypeError, match="not a dataclass"):
        from_mapping(int, {}, "test")


def test_a_plain_dict_builds_the_same_settings_again() -> None:
    full = Outer(3, 1.5, True, 0.02, 7.0, (1.0, 2.0), Inner(2.0, "a"), (Inner(3.0), Inner(4.0)))
    assert from_mapping(Outer, to_dict(full), "test") == full


def test_a_plain_dict_holds_lists_and_dicts_only() -> None:
    found = to_dict(Outer(1, 2.0, speeds=(3.0,), parts=(Inner(4.0),)))
    assert found == {
        "count": 1,
        "length": 2.0,
        "active": False,
        "period": 0.01,
        "limit": None,
        "speeds": [3.0],
        "inner": {"gain": 1.0, "name": "inner"},
        "parts": [{"gain": 4.0, "name": "inner"}],
    }
    assert [type(found[name]) for name in ("speeds", "parts")] == [list, list]


@pytest.mark.parametrize("content", [b"count = ", b"\xff\xfe"])
def test_a_file_that_is_not_toml_is_refused_by_name(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "suite.toml").write_bytes(content)
    with pytest.raises(InputFileError, match=r"suite\.toml is not valid TOML"):
        load_toml(tmp_path / "suite.toml")


def test_a_file_that_does_not_exist_is_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(InputFileError, match=r"cannot read .*none\.toml: No such file"):
        load_toml(tmp_path / "none.toml")


def test_an_unknown_configuration_names_the_nearest() -> None:
    with pytest.raises(
        ArgumentError, match=r"benchmark configuration 'smok'; did you mean 'smoke'"
    ):
        config_path("benchmark", "smok")


def test_a_name_far_from_all_others_lists_them_in_order() -> None:
    assert str(unknown_name("thing", "zzz", ["beta", "alpha"])).endswith("known: alpha, beta")


def test_a_name_where_none_exists_says_so() -> None:
    assert str(unknown_name("thing", "a", [])).endswith("none exists")


@pytest.mark.parametrize("check", [check_finite, check_positive, check_not_negative])
@pytest.mark.parametrize("value", [True, False, "1.5", "", None, [1.0], 1j])
def test_what_is_not_a_number_is_refused(check, value: object) -> None:
    with pytest.raises(ArgumentError, match=r"^gain = .* is not a number; give one in N$"):
        check("gain", value, "N")


@pytest.mark.parametrize("check", [check_finite, check_positive, check_not_negative])
@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf"), np.float32("nan")])
def test_a_number_that_is_not_finite_is_refused(check, value: float) -> None:
    with pytest.raises(ArgumentError, match=r"^gain = .* must be finite; give a number in N$"):
        check("gain", value, "N")


@pytest.mark.parametrize("value", [2, 2.0, np.float32(2.0), np.int64(2), np.array(2.0)])
def test_any_kind_of_number_becomes_a_float(value: object) -> None:
    found = check_finite("gain", value)  # type: ignore[arg-type]
    assert (found, type(found)) == (2.0, float)


@pytest.mark.parametrize("value", [0.0, -1.0])
def test_what_is_not_above_zero_is_not_positive(value: float) -> None:
    with pytest.raises(ArgumentError, match="must be above zero"):
        check_positive("gain", value)


def test_the_smallest_number_above_zero_is_positive() -> None:
    assert check_positive("gain", 5e-324) == 5e-324


def test_zero_is_not_negative() -> None:
    assert check_not_negative("gain", 0.0) == 0.0


def test_a_number_below_zero_is_refused_where_it_must_not_be_negative() -> None:
    with pytest.raises(ArgumentError, match="must not be negative"):
        check_not_negative("gain", -5e-324)


@pytest.mark.parametrize("value", [True, False, 2.0, np.float64(2.0), "2", None])
def test_what_is_not_whole_is_no_count(value: object) -> None:
    with pytest.raises(ArgumentError, match=r"jobs = .* is not a whole number; give 1 or more"):
        check_count("jobs", value)


@pytest.mark.parametrize(("value", "minimum"), [(0, 1), (-1, 0), (4, 5)])
def test_a_count_below_its_minimum_is_refused(value: int, minimum: int) -> None:
    with pytest.raises(ArgumentError, match=f"is too small; give {minimum} or more"):
        check_count("jobs", value, minimum)


@pytest.mark.parametrize(("value", "minimum"), [(0, 0), (1, 1), (np.int64(7), 7)])
def test_a_count_at_its_minimum_is_an_int(value: object, minimum: int) -> None:
    found = check_count("jobs", value, minimum)
    assert (found, type(found)) == (minimum, int)


def test_a_number_spelled_as_text_is_read() -> None:
    assert check_text("gain", "35e3") == 35e3


@pytest.mark.parametrize("text", ["", "ten", "nan", "inf", "1,5"])
def test_text_that_spells_no_finite_number_is_refused(text: str) -> None:
    with pytest.raises(ArgumentError, match=f"^gain = {text!r} is not a finite number; .* in N$"):
        check_text("gain", text, "N")
