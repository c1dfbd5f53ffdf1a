import pytest

from benchmarks.study import StudySpeed


def test_ratios_compare_one_process_with_two_and_images_with_maps() -> None:
    speed = StudySpeed(
        frames=60, cores=2, one_process_s=40.0, two_processes_s=20.0, maps_recorded_s=5.0, maps_reused_s=2.0,
        finished_again_s=1.5, job_s=2.5, load=(0.0, 2.0),
    )  # fmt: skip
    assert speed.ratios == pytest.approx({"two_processes": 2.0, "finished_again_s": 1.5, "from_maps": 10.0})
