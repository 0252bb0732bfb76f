"""The race to shapes: a run is found again under the name of the method that it is."""

import pytest
import shapes
from omegaconf import OmegaConf

from isas_cli.config.compose import compose, translate


@pytest.mark.parametrize("scene", shapes.SCENES)
def test_a_runs_configuration_names_its_method(scene):
    for name, settings in shapes.methods(scene).items():
        chosen = [f"scene={scene}", *(f"{key}={value}" for key, value in settings.items())]
        config = OmegaConf.to_container(compose(translate(chosen)))
        assert shapes.name_of(config, scene) == name
