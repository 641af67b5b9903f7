"""The columns of a recording: time, wrench and, if the file holds it, gravity."""

from probedesign.core.csv_tables import WRENCH, WRENCH_ALIASES, WRENCH_KINDS, Column, CsvLines, find_columns

GRAVITY = ("gx", "gy", "gz")
KINDS = {"time": "time", **WRENCH_KINDS, **dict.fromkeys(GRAVITY, "gravity")}
ALIASES = {"t": "time", "timestamp": "time", **WRENCH_ALIASES}

HEADER = "time_s,Fx_N,Fy_N,Fz_N,Mx_Nm,My_Nm,Mz_Nm"
GRAVITY_HEADER = "gx_m_s2,gy_m_s2,gz_m_s2"


def columns_of(table: CsvLines) -> list[Column]:
    """The columns to read: time, wrench and, if they are there, gravity.

    Raises:
        InputError: a column is missing, doubled or without a known unit.
    """
    found = find_columns(table, KINDS, ALIASES, HEADER)
    wanted = ("time", *WRENCH, *(GRAVITY if found.keys() & set(GRAVITY) else ()))
    names = f"{HEADER},{GRAVITY_HEADER}".split(",")
    missing = [name for quantity, name in zip(wanted, names, strict=False) if quantity not in found]
    if missing:
        told = ", ".join(missing)
        table.fail(table.header_number, f"columns are missing: {told}; the header must be like {HEADER}")
    return [found[quantity] for quantity in wanted]
