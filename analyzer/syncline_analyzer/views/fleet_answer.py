"""Answers of a fleet: a text table, CSV, JSON lines or a parquet file."""

import csv
import json
import sys
from collections.abc import Iterator, Mapping, Sequence
from decimal import Decimal
from itertools import islice
from pathlib import Path
from typing import Any, TextIO

import pyarrow as pa
import pyarrow.parquet as pq

from syncline_analyzer.fleet.questions import QUESTIONS, option_name

MAX_ROWS = 200
"""Rows of a text table; more are counted."""
_FORMULA = "=+-@\t\r"
"""A cell that begins so would be a formula to a spreadsheet."""
_MAX_CELL = 60


def write_answer(reader: pa.RecordBatchReader, form: str, path: Path | None) -> None:
    """Write an answer as text, csv, jsonl or parquet: to a file, or to standard output."""
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
    if form == "parquet" and path is not None:
        write_parquet(reader, path)
        return
    write = {"text": write_text, "csv": write_csv, "jsonl": write_jsonl}[form]
    if path is None:
        write(reader, sys.stdout)
        return
    with path.open("w", encoding="utf-8", newline="") as stream:
        write(reader, stream)


def overview_lines(tables: Mapping[str, int]) -> Iterator[str]:
    """What can be asked: questions with their options, and tables with how many captures have rows."""
    yield "Questions (--question NAME):"
    width = max(map(len, QUESTIONS))
    for name, question in QUESTIONS.items():
        yield f"  {name.ljust(width)}  {question.meaning}"
        yield f"  {' ' * width}  {' '.join(option_name(each) for each in question.options)}"
    yield "Tables for SQL, with the number of captures that have rows of them:"
    width = max(map(len, tables))
    for name, captures in tables.items():
        if captures:
            yield f"  {name.ljust(width)}  {captures}"
    yield 'Columns of a table: "DESCRIBE nodes"'


def write_text(reader: pa.RecordBatchReader, stream: TextIO, max_rows: int = MAX_ROWS) -> None:
    """A table with aligned columns, numbers to the right."""
    rows = _rows(reader)
    shown = [[_shown(value) for value in row] for row in islice(rows, max_rows)]
    more = sum(1 for _ in rows)
    heads = [_printable(name) for name in reader.schema.names]
    widths = [max(map(len, column)) for column in zip(heads, *shown, strict=True)]
    right = [_is_number(field.type) for field in reader.schema]
    for row in (heads, *shown):
        cells = (
            cell.rjust(width) if number else cell.ljust(width)
            for cell, width, number in zip(row, widths, right, strict=True)
        )
        stream.write("  ".join(cells).rstrip() + "\n")
    total = len(shown) + more
    if more:
        stream.write(f"({max_rows} of {total} rows; --format csv, jsonl or parquet has all)\n")
    elif total != 1:
        stream.write(f"({total or 'no'} rows)\n")


def write_csv(reader: pa.RecordBatchReader, stream: TextIO) -> None:
    """Comma-separated values with one head line; lists are JSON.

    Text that a spreadsheet would take for a formula gets an apostrophe before it.
    """
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow([_no_formula(name) for name in reader.schema.names])
    for row in _rows(reader):
        writer.writerow([_cell(value) for value in row])


def write_jsonl(reader: pa.RecordBatchReader, stream: TextIO) -> None:
    """One JSON object a line; what is no finite number is null."""
    names = reader.schema.names
    for row in _rows(reader):
        values = (_json_value(value) for value in row)
        stream.write(json.dumps(dict(zip(names, values, strict=True)), ensure_ascii=False) + "\n")


def write_parquet(reader: pa.RecordBatchReader, path: Path) -> int:
    """A parquet file, which appears when it is whole; how many rows it has."""
    part = path.with_name(f".{path.name}.part")
    rows = 0
    try:
        with pq.ParquetWriter(part, reader.schema) as writer:
            for batch in reader:
                writer.write_batch(batch)
                rows += batch.num_rows
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)
    return rows


def _rows(reader: pa.RecordBatchReader) -> Iterator[tuple[Any, ...]]:
    for batch in reader:
        yield from zip(*(_values(column) for column in batch.columns), strict=True)


def _values(column: pa.Array) -> Sequence[Any]:
    """Values of a column; stamps as text in UTC with all their digits."""
    if not pa.types.is_timestamp(column.type):
        return column.to_pylist()  # type: ignore[no-any-return]
    zone = "Z" if column.type.tz else ""
    texts = column.cast(pa.timestamp(column.type.unit)).cast(pa.string()).to_pylist()
    return [text and text.replace(" ", "T") + zone for text in texts]


def _is_number(type_: pa.DataType) -> bool:
    kinds = (pa.types.is_integer, pa.types.is_floating, pa.types.is_decimal)
    return any(kind(type_) for kind in kinds)


def _shown(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, bool):
        return "yes" if value else "no"
    text = _printable(_plain(value))
    return text if len(text) <= _MAX_CELL else f"{text[: _MAX_CELL - 1]}…"


def _cell(value: Any) -> Any:
    if value is None or isinstance(value, bool | int | float | Decimal):
        return value
    return _no_formula(_plain(value))


def _no_formula(text: str) -> str:
    """Text that no spreadsheet calculates.

    >>> _no_formula("=1+2"), _no_formula("-12.5"), _no_formula("boom sensor")
    ("'=1+2", '-12.5', 'boom sensor')
    """
    if not text.lstrip(" \n").startswith(tuple(_FORMULA)):
        return text
    try:
        float(text)
    except ValueError:
        return f"'{text}"
    return text


def _plain(value: Any) -> str:
    if isinstance(value, list | dict):
        return json.dumps(_json_value(value), ensure_ascii=False)
    return str(value)


def _json_value(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _json_value(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_json_value(each) for each in value]
    if isinstance(value, float):
        return value if abs(value) < float("inf") else None
    if isinstance(value, Decimal):
        return int(value) if value == value.to_integral_value() else float(value)
    if value is None or isinstance(value, bool | int | str):
        return value
    return str(value)


def _printable(text: str) -> str:
    """Text without what would move a terminal's cursor."""
    return "".join(each if each.isprintable() else "·" for each in text)
