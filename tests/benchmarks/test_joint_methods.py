"""The races of joint problems: a run is found again under the name of the method that it is."""

import pbdr
import pytest
from omegaconf import OmegaConf

from isas_cli.config.compose import compose, translate


@pytest.mark.parametrize("scene", pbdr.SCENES)
def test_a_runs_configuration_names_its_method(scene):
    for name, settings in pbdr.methods(scene).items():
        chosen = [f"scene={scene}", *(f"{key}={value}" for key, value in settings.items())]
        config = OmegaConf.to_container(compose(translate(chosen)))
        assert pbdr.name_of(config, scene) == name
