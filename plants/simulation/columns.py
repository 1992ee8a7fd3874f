"""Arrays as columns of Arrow tables, and back, bit for bit: numbers, complex ones, texts, with any number of axes."""

import json
from collections.abc import Iterable, Sequence

import numpy as np
import pyarrow as pa

from plants.errors import StoreError


def column(name: str, values: np.ndarray, missing: np.ndarray | None = None) -> tuple[pa.Field, pa.Array]:
    """A field and its column (n,) of an array (n, ...), whose rows become lists; `missing` (n,) are null.

    Of a missing list the entries are null, not the list itself, which Arrow could not read back before version 26.

    Raises
    ------
    StoreError
        Neither numbers nor text.
    """
    told, text = {}, values.dtype.kind in "UO"
    if values.dtype.kind == "c":
        told["complex"] = "true"  # pairs of numbers
        values = np.ascontiguousarray(values).reshape(*values.shape, 1).view(np.real(values).dtype)
    shape = values.shape[1:]
    if shape:
        told["shape"] = json.dumps(shape)
    if 0 in shape:  # Arrow has no empty lists of one length
        values = np.zeros(len(values), values.dtype)
    size = int(np.prod(values.shape[1:]))
    mask = np.repeat(missing, size) if missing is not None and missing.any() else None
    flat = np.ascontiguousarray(values).reshape(-1)
    try:
        made = pa.array(flat.tolist() if text else flat, pa.string() if text else None, mask=mask)
    except (pa.ArrowException, UnicodeError) as error:
        raise StoreError(
            f"{name} of type {values.dtype} cannot be stored ({error}): give numbers or plain text"
        ) from error
    if values.ndim > 1:
        made = pa.FixedSizeListArray.from_arrays(made, type=pa.list_(made.type, size))
    return pa.field(name, made.type, metadata=told or None), made


def array(stored: pa.ChunkedArray, field: pa.Field) -> np.ndarray:
    """The array that `column` was given; what is missing is NaN, "" among texts."""
    told = field.metadata or {}
    shape = json.loads(told.get(b"shape", b"[]"))
    there = np.asarray(stored.is_valid())
    full = stored.drop_null() if stored.null_count else stored
    if pa.types.is_fixed_size_list(full.type):
        size = full.type.list_size
        full = pa.chunked_array([part.flatten() for part in full.chunks], full.type.value_type)
        there[there] = np.asarray(full.is_valid()).reshape(-1, size).all(axis=1)
        full = full.drop_null()
    text = pa.types.is_string(full.type)
    values = np.array(full.to_pylist(), str) if text else full.to_numpy()
    values = np.zeros((len(values), *shape), values.dtype) if 0 in shape else values.reshape(-1, *shape)
    if not there.all():
        blank = np.array("") if text else np.array(np.nan)
        wide = np.full((len(there), *shape), blank, values.dtype if text else np.result_type(values, np.float64))
        wide[there] = values
        values = wide
    return values.view(np.result_type(values, np.complex64))[..., 0] if b"complex" in told else values


def together(tables: Sequence[pa.Table], where: str) -> pa.Table:
    """One table; a column with whole numbers in some of them and others elsewhere is what NumPy makes of it.

    Raises
    ------
    StoreError
        A column has texts or lengths that others do not have; `where` begins the message.
    """
    kinds: dict[str, set[pa.DataType]] = {}
    for field in (field for table in tables for field in table.schema):
        kinds.setdefault(field.name, set()).add(field.type)
    try:
        for name, found in kinds.items():
            if len(found) > 1:
                wide = _wide(found)
                tables = [_cast(table, name, wide) for table in tables]
        return pa.concat_tables(tables, promote_options="default")
    except (pa.ArrowException, TypeError) as error:
        raise StoreError(
            f"{where}: chunks do not fit together ({error}); remove the one that does not belong"
        ) from error


def _wide(kinds: Iterable[pa.DataType]) -> pa.DataType:
    """The type of numbers, or of lists of them, that holds all of these; TypeError if there is none."""
    lists = {kind.list_size if pa.types.is_fixed_size_list(kind) else None for kind in kinds}
    if len(lists) > 1:
        raise TypeError(f"lists of {lists} entries")
    size = lists.pop()
    inner = [kind if size is None else kind.value_type for kind in kinds]
    if any(pa.types.is_string(kind) for kind in inner):
        raise TypeError("texts and numbers")
    wide = pa.from_numpy_dtype(np.result_type(*[kind.to_pandas_dtype() for kind in inner]))
    return wide if size is None else pa.list_(wide, size)


def _cast(table: pa.Table, name: str, kind: pa.DataType) -> pa.Table:
    """The table with a column of another type, if it has it."""
    place = table.schema.get_field_index(name)
    if place < 0:
        return table
    values, field = table.column(place), table.schema.field(place).with_type(kind)
    size = kind.list_size if pa.types.is_fixed_size_list(kind) else None
    if pa.types.is_boolean(values.type if size is None else values.type.value_type):
        ones = pa.uint8() if size is None else pa.list_(pa.uint8(), size)
        values = values.cast(ones)  # because Arrow casts no truth value to a half float
    return table.set_column(place, field, values.cast(kind, safe=False))
