"""Tables of tracks from arrays."""

from calib.types import F64, I64
from planview.trajectories.table import BOX_COLUMNS, Trajectories, table_of


def positions_table(
    frame: I64, track_id: I64, xy_m: F64, height_m: F64 | None = None, timestamp_s: F64 | None = None,
    box_px: F64 | None = None, visible: F64 | None = None,
) -> Trajectories:  # fmt: skip
    """A table of confirmed rows from arrays of length N; what is not given is unknown."""
    columns = {"frame": frame, "id": track_id, "x_m": xy_m[:, 0], "y_m": xy_m[:, 1]}
    if box_px is not None:
        columns |= zip(BOX_COLUMNS, box_px.T, strict=True)
    for name, values in (("height_m", height_m), ("timestamp_s", timestamp_s), ("visible", visible)):
        if values is not None:
            columns[name] = values
    return table_of(columns, "tracks")
