"""What counts as a floor."""

from __future__ import annotations

from pydantic import Field

from calib.params import Params


class FloorParams(Params):
    """What counts as a floor."""

    disparity_std_px: float = Field(default=0.15, gt=0, le=5)
    """Deviation of the background's disparity after medians [px]: what sub-pixel bias leaves (our choice)."""
    frame_noise: float = Field(default=3.0, ge=1, le=20)
    """Deviation of a single frame's disparity against that of the medians [1] (our choice: 0.45 px)."""
    inlier_sigmas: float = Field(default=3.0, gt=0.5, le=10)
    """Points within this many deviations lie on a plane: 99.7 % of Gaussian noise (our choice)."""
    min_height_m: float = Field(default=0.8, gt=0, le=100)
    """Lowest camera: below it people are taller than the view (our choice)."""
    max_height_m: float = Field(default=12.0, gt=0, le=100)
    """Highest camera: beyond it a person covers a few disparities at most (our choice)."""
    max_tilt_deg: float = Field(default=83.0, gt=0, lt=90)
    """Steepest view of a floor; beyond it the plane is a wall seen from above (our choice)."""
    min_tilt_deg: float = Field(default=-12.0, gt=-90, le=0)
    """An overhead camera may lean backwards by this much; beyond it the plane is a wall in front of a camera
    that hardly sees its floor (our choice)."""
    max_roll_deg: float = Field(default=30.0, gt=0, lt=90)
    """Cameras are mounted roughly upright (Zhang 2008, section 2, assumption 3: no significant roll)."""
    min_inlier_fraction: float = Field(default=0.05, gt=0, le=1)
    """Least share of the valid depth a floor covers (our choice: less is a shelf or a step)."""
    below_margin_m: float = Field(default=0.25, ge=0, le=2)
    """Points count as beneath a plane from here on [m]: lower than a seat, more than calibration warps (our choice)."""
    max_below_fraction: float = Field(default=0.2, gt=0, lt=1)
    """Points beneath the plane, against points on and beneath it: nothing is seen below a floor but errors of
    matching; below a table top or a plane through clutter much is. A parallel plane beneath that holds this share
    is the floor instead (our choice)."""
    max_blur_fraction: float = Field(default=0.5, gt=0, le=1)
    """Points just above the plane's layer of noise, in as thick a layer, against points on it: a flat surface ends
    sharply, a plane laid through clutter or a corner does not (our choice)."""
    min_sharpness: float = Field(default=0.56, ge=0, le=1)
    """Least share, of the points near a plane, within half that distance: 0.5 where points fill a volume, whose
    medians make a plane too; above 0.8 on a surface (our choice)."""
    people_m: float = Field(default=2.4, gt=0.5, le=5)
    """People reach no higher [m] (Harville 2002, section 4: H_max)."""
    max_high_fraction: float = Field(default=0.25, gt=0, le=1)
    """Share of what moves that may be higher: errors of matching (our choice)."""
    n_candidates: int = Field(default=8, ge=1, le=50)
    """Planes looked for, largest first; a room has a floor, three walls and some furniture (our choice)."""
    ransac_iterations: int = Field(default=2000, ge=10, le=100_000)
    """Triples tried per candidate: one of 2000 hits a plane of 12 % of the remaining points with 97 % (our choice)."""
    fit_points: int = Field(default=400_000, ge=1000, le=10_000_000)
    """Points looked at over all frames, evenly thinned (our choice, for speed)."""
    edge_cells: float = Field(default=2.5, ge=0, le=20)
    """Floor this close to something on it is left out of the last fits, in cells (our choice: 25 px at 640 px, what
    semi-global matching smooths over)."""
    cells_across: int = Field(default=64, ge=8, le=512)
    """Cells across the view whose medians are fitted (our choice: 10 px wide at 640 px)."""
