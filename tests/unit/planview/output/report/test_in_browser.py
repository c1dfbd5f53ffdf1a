"""The report in a browser: on a phone, and in the dark."""

import shutil
import subprocess
from pathlib import Path

import cv2
import numpy as np
import pytest

from calib.types import U8
from planview.output.report.page import write_report

NAMES = ("chromium", "chromium-browser", "google-chrome")
CHROMIUM = next((found for name in NAMES if (found := shutil.which(name))), None)

pytestmark = [pytest.mark.slow, pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine")]


def screenshot(page: Path, width: int, *options: str) -> U8:
    """(H, W, 3) BGR."""
    target = page.with_suffix(".png")
    size = f"--window-size={width},1600"
    command = [CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", size, *options]
    subprocess.run([*command, f"--screenshot={target}", page.as_uri()], capture_output=True, timeout=60, check=True)
    picture = cv2.imread(str(target))
    return np.asarray(picture, dtype=np.uint8)


def test_page_fits_a_phone(street):
    picture = screenshot(write_report(street), 500)
    assert (picture[:, -8:] == 255).all()  # nothing is wider than the page, whose border is empty
    assert (picture < 250).any(axis=2).mean() > 0.2


def test_page_is_dark_where_the_browser_is(street):
    picture = screenshot(write_report(street), 1000, "--blink-settings=preferredColorScheme=0")
    assert picture[:20].max() < 60  # the empty border above the title
