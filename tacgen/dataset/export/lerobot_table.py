"""LeRobot's features as Arrow columns, images as PNG bytes."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any

import cv2
import numpy as np
import pyarrow as pa
from numpy.typing import NDArray


def arrow_schema(features: Mapping[str, Mapping[str, Any]]) -> pa.Schema:
    """The Arrow schema, with the note by which Hugging Face's datasets knows the images."""
    fields: list[pa.Field] = []
    described: dict[str, dict[str, Any]] = {}
    for name, feature in features.items():
        length, dtype = feature["shape"][0], feature["dtype"]
        if dtype == "image":
            kind: pa.DataType = pa.struct([("bytes", pa.binary()), ("path", pa.string())])
            described[name] = {"_type": "Image"}
        elif length == 1:
            kind = pa.from_numpy_dtype(dtype)
            described[name] = {"dtype": dtype, "_type": "Value"}
        else:
            kind = pa.list_(pa.from_numpy_dtype(dtype), length)
            value = {"dtype": dtype, "_type": "Value"}
            described[name] = {"feature": value, "length": length, "_type": "Sequence"}
        fields.append(pa.field(name, kind))
    note = json.dumps({"info": {"features": described}})
    return pa.schema(fields, metadata={"huggingface": note})


def episode_table(
    values: Mapping[str, NDArray[Any]], features: Mapping[str, Mapping[str, Any]], schema: pa.Schema
) -> pa.Table:
    """One episode as a table: ``values`` holds (T, …) of every feature."""
    columns = []
    for field_ in schema:
        array = values[field_.name]
        if features[field_.name]["dtype"] == "image":
            rows: list[Any] = [{"bytes": png, "path": None} for png in _pngs(array)]
        else:
            rows = array.astype(features[field_.name]["dtype"]).tolist()
        columns.append(pa.array(rows, type=field_.type))
    return pa.Table.from_arrays(columns, schema=schema)


def _pngs(images: NDArray[np.uint8]) -> Iterator[bytes]:
    for rgb in images:
        _, data = cv2.imencode(".png", np.ascontiguousarray(rgb[..., ::-1]))
        yield data.tobytes()
