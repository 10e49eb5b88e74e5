"""Two runs have one digest exactly if their results are the same, bit for bit."""

import sqlite3
from pathlib import Path

import numpy as np
import pytest
from store_examples import SETTINGS, SPEC, cell, go_on, write

from eval.store.digest import digest
from eval.store.schema import COLUMNS
from eval.store.store import Store


@pytest.mark.parametrize("name", COLUMNS)
def test_the_digest_sees_every_column_but_the_message(tmp_path: Path, name: str) -> None:
    write(tmp_path, range(1))
    before = digest(tmp_path)
    value = {"seed": 10**6, "status": "diverged", "unstable": None, "force_rms": None}
    connection = sqlite3.connect(tmp_path / "records.sqlite")
    with connection:
        connection.execute(
            f"UPDATE cells SET {name} = ? WHERE seed = 7",
            (value.get(name, "other" if COLUMNS[name] == "TEXT" else 0.5),),
        )
    connection.close()
    assert (digest(tmp_path) == before) == (name == "message")


def test_the_digest_sees_the_last_bit_of_a_number(tmp_path: Path) -> None:
    for name, value in (("a", 2.0), ("b", np.nextafter(2.0, 3.0)), ("c", 2.0)):
        with Store.create(tmp_path / name, SETTINGS) as store:
            store.begin_session(name)
            store.add_controller(SPEC, "untold")
            store.add_package(SPEC, "p", [cell(measures={"force_rms": value})], 1.0)
    assert digest(tmp_path / "a") == digest(tmp_path / "c") != digest(tmp_path / "b")


def test_the_digest_does_not_depend_on_the_order_or_the_sessions(tmp_path: Path) -> None:
    write(tmp_path / "a", range(4))
    with Store.create(tmp_path / "b", SETTINGS) as store:
        go_on(store, range(3, 1, -1))
    with Store.resume(tmp_path / "b", SETTINGS) as store:
        go_on(store, range(4))
    assert digest(tmp_path / "a") == digest(tmp_path / "b")
    write(tmp_path / "c", range(3))
    assert digest(tmp_path / "a") != digest(tmp_path / "c")
