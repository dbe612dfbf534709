"""No shipped file writes out a value that is the default."""

from collections.abc import Iterator
from typing import Any

from pydantic import BaseModel

from configs.flight_tree import FEATURES_FILE, ScenarioFile
from configs.loader import CONFIG_DIRECTORY, fill, load, read_tree
from configs.parts import part_names, read_part
from configs.vehicle import read_vehicle
from experiments.campaigns.campaign import CampaignConfig
from experiments.campaigns.tuning import TuneConfig
from experiments.link.dropout_trace import PatternFile
from onboard.control.cascade import CascadeSettings
from protocol.feature_config import FeaturesConfig
from sim_vehicle.config import SimVehicleConfig
from sim_vehicle.link.radio import RadioConfig


def written_defaults(record: Any, at: str = "") -> Iterator[str]:
    """The paths of values that were given and are the default."""
    if isinstance(record, tuple | dict):
        for key, one in record.items() if isinstance(record, dict) else enumerate(record):
            yield from written_defaults(one, f"{at}{key}.")
    if not isinstance(record, BaseModel):
        return
    for name, field in type(record).model_fields.items():
        value = getattr(record, name)
        if name not in record.model_fields_set or name == "kind":
            continue
        if not field.is_required() and value == field.get_default(call_default_factory=True):
            yield f"{at}{name}"
        else:
            yield from written_defaults(value, f"{at}{name}.")


def disturbances(items: Any) -> tuple[Any, ...]:
    tree = read_vehicle("mambo").simulated | {"disturbances": items}
    return fill(SimVehicleConfig, tree, "test").disturbances


def records() -> Iterator[tuple[str, Any]]:
    """Every shipped file as the records that it fills."""
    features = load(FeaturesConfig, FEATURES_FILE)
    yield "features", features
    for name in part_names("scenarios"):
        tree = read_part("scenarios", name)
        file = fill(ScenarioFile, tree, name)
        yield f"scenario {name}", (file, disturbances(file.disturbances), fill(RadioConfig, file.radio_values, name))
    for name in part_names("dropouts"):
        pattern = fill(PatternFile, read_part("dropouts", name), name)
        yield f"dropout {name}", (pattern, fill(RadioConfig, pattern.radio_values, name))
    for name in part_names("radio"):
        yield f"radio {name}", fill(RadioConfig, read_part("radio", name), name)
    for name in part_names("vehicles"):
        yield f"vehicle {name}", fill(SimVehicleConfig, read_vehicle(name).simulated, name)
    for name in part_names("controllers"):
        settings = read_part("controllers", name)["settings"] | {"features": features}
        yield f"controller {name}", fill(CascadeSettings, settings, name)
    for name in part_names("campaigns"):
        tree = read_tree(CONFIG_DIRECTORY / "campaigns" / f"{name}.yaml")
        campaign: Any = fill(TuneConfig if "own" in tree else CampaignConfig, tree, name)
        cases = [getattr(case, "case", case) for case in campaign.cases]
        yield f"campaign {name}", (campaign, *(disturbances(one.set.get("vehicle.disturbances", ())) for one in cases))


OVERRULES = {"scenario blackout: 0.radio"}
"""Values that overrule one of the file that is extended."""


def test_no_file_writes_out_a_default() -> None:
    found = {f"{name}: {path}" for name, record in records() for path in written_defaults(record)}
    assert found == OVERRULES
