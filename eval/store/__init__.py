"""A benchmark's records: one SQLite file in the run's folder.

    schema.py       tables and columns, and the steps from older versions to this one
    settings.py     what a run was started with; what differs when it is resumed with something else
    cell.py         one cell's row, checked
    connection.py   opening the file for reading or writing; SQLite's errors in this project's words
    check.py        whether every value is one of its column
    shapes.py       whether an answer can be shown
    reader.py       `Reader`: everything that can be asked, also while another process writes
    packages.py     writing one package: its cells and its mark
    answers.py      writing one answer on a controller: on its stability, or on its motion
    store.py        `Store`: a reader that also writes, package by package
    digest.py       `digest`: the equality test of two runs' results
    export.py       `export`: the cells as CSV or Parquet

A package's rows and the mark that it is done are written in one transaction, so that a process
killed at any moment leaves whole packages. While a store is open for writing, the file is in WAL
mode with `records.sqlite-wal` and `-shm` beside it; once closed it is one plain file again.

Numbers come back bit for bit, with two exceptions that SQLite makes: NaN becomes NULL (None here),
and minus zero becomes zero.
"""
