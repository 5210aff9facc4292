"""A table in a file of a format, which comes back bit for bit.

Where a format has them, vectors, matrices and complex numbers stay whole; elsewhere each element is a column.
"""

import csv
import json
import math
from importlib.metadata import version
from io import TextIOWrapper
from pathlib import Path
from typing import BinaryIO

import numpy as np

from cogradar.services.analysis.arrays.records import flat, in_parts
from cogradar.services.analysis.export.tables import OF_RUN, Table, attributes_of
from cogradar.services.analysis.export.whole import as_os_error
from cogradar.services.analysis.optional import library


def write_csv(columns: Table, stream: BinaryIO) -> None:
    """Numbers as Python writes them; what is unknown is empty."""
    columns, text = flat(columns), TextIOWrapper(stream, encoding="utf-8", newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    for row in zip(*(values.tolist() for values in columns.values()), strict=True):
        writer.writerow(["" if _is_unknown(value) else value for value in row])
    text.detach()  # or it would close the stream


def _is_unknown(value: object) -> bool:
    return isinstance(value, float) and math.isnan(value)


def write_json(columns: Table, stream: BinaryIO) -> None:
    """An array of objects, one per row; what is unknown is null."""
    columns = flat(columns)
    rows = [
        {name: None if _is_unknown(value) else value for name, value in zip(columns, row, strict=True)}
        for row in zip(*(values.tolist() for values in columns.values()), strict=True)
    ]
    stream.write(json.dumps(rows).encode())


def write_npz(columns: Table, stream: BinaryIO) -> None:
    """An array per column."""
    np.savez_compressed(stream, allow_pickle=False, **columns)


def write_mat(columns: Table, stream: BinaryIO) -> None:
    """MATLAB's version 5: a column vector per column, or an array whose first index is the row; texts are rows of
    characters.
    """
    from scipy.io import savemat

    savemat(stream, columns, oned_as="column", do_compression=True)  # type: ignore[arg-type] # it takes files, too; its stubs lack them


def write_parquet(columns: Table, stream: BinaryIO) -> None:
    """What is unknown is null. Raises BadInput without pyarrow."""
    pyarrow = library("pyarrow", "parquet", "parquet")
    arrays = {name: pyarrow.array(values, from_pandas=True) for name, values in flat(columns).items()}
    library("pyarrow.parquet", "parquet", "parquet").write_table(pyarrow.table(arrays), stream)


def write_netcdf(columns: Table, file: Path) -> None:
    """NetCDF 4: a variable per column, of dimension `row` and one per side of a matrix; unknown values are NaN.

    Which run it is stands in the attributes of the file. Raises BadInput without netCDF4.
    """
    netcdf, n_row = library("netCDF4", "netcdf", "netcdf"), len(next(iter(columns.values())))
    with as_os_error(), netcdf.Dataset(file, "w", format="NETCDF4") as dataset:
        dataset.setncatts({"source": f"cogradar {version('cogradar')}"})
        dataset.setncatts({name: columns[name][0] for name in OF_RUN if name in columns and n_row})
        dataset.createDimension("row", n_row)
        for name in [name for name in columns if name not in OF_RUN]:
            sides = {f"{name}_{i}": size for i, size in enumerate(columns[name].shape[1:])}
            for side, size in sides.items():
                dataset.createDimension(side, size)
            for part, values in in_parts({name: columns[name]}).items():
                is_text, is_flag = values.dtype.kind == "U", values.dtype.kind == "b"
                kind = str if is_text else np.int8 if is_flag else values.dtype
                compression = {} if is_text or not values.size else {"compression": "zlib"}
                variable = dataset.createVariable(part, kind, ("row", *sides), **compression)
                variable[:] = values.astype(object if is_text else kind)
                variable.setncatts(attributes_of(part))
