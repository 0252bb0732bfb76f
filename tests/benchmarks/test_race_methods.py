"""Races of methods: a run is found again under the name of the method that it is."""

import pbdr
import pytest
import shapes
from omegaconf import OmegaConf

from isas_cli.config.compose import compose, translate


@pytest.mark.parametrize(
    "script, scene", [(script, scene) for script in (shapes, pbdr) for scene in script.SCENES]
)
def test_a_runs_configuration_names_its_method(script, scene):
    for name, settings in script.methods(scene).items():
        chosen = [f"scene={scene}", *(f"{key}={value}" for key, value in settings.items())]
        config = OmegaConf.to_container(compose(translate(chosen)))
        assert script.name_of(config, scene) == name
