"""Parts of the engine switched off by name."""

import pytest

from calib.errors import InputError
from planview.engine.ablations import ABLATIONS, ablated
from planview.engine.config import Config, load_config


@pytest.mark.parametrize("name", ABLATIONS)
def test_every_ablation_changes_the_configuration(name: str) -> None:
    assert ablated(name) != Config()


def test_ablation_keeps_what_it_does_not_switch_off() -> None:
    config = ablated("joint search off", load_config(None, ["maps.cell_m=0.05"]))
    assert (config.template.joint, config.maps.cell_m) == (False, 0.05)


def test_unknown_ablation_is_refused_by_name() -> None:
    with pytest.raises(InputError, match=r"expected one of height only, .* found 'telepathy'"):
        ablated("telepathy")
