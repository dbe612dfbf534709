"""A campaign that was flown: what its folder, or a file of published rows, says it is about, and the rows."""

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import pyarrow as pa
import pyarrow.parquet as pq

from configs.loader import ConfigError, fill, parse_yaml, read_tree
from experiments.campaigns.campaign import CampaignConfig, fingerprint
from experiments.campaigns.store import PARQUET, read_table, write_table
from shell.files import write_atomically

CAMPAIGN_FILE: Final = "campaign.yaml"
"""What the folder is about: name, fingerprint, where it was flown, the campaign."""
_ABOUT: Final = b"campaign.yaml"
"""Under this key published rows carry the same."""


@dataclass(frozen=True)
class FlownCampaign:
    """Rows and what they are rows of."""

    place: Path
    """The folder or the file."""
    name: str
    config: CampaignConfig
    """The campaign as it was flown."""
    fingerprint: str
    """Of the settings it was flown with."""
    flown_on: tuple[str, ...]
    """Machines and versions, a line each."""
    table: pa.Table
    """Columns of experiments.campaigns.store.SCHEMA."""


def check_fingerprint(mark: str, campaign: CampaignConfig, where: str, advice: str) -> None:
    """Raises ConfigError if flights under `mark` are not those that campaign and configs make today."""
    if mark != fingerprint(campaign.model_dump(mode="json")):
        raise ConfigError(
            f"{where}: its flights were made with other settings: campaign or configs have changed since; {advice}"
        )


def read_flown(place: Path) -> FlownCampaign:
    """Reads a campaign's folder, or a file of published rows.

    Raises
    ------
    ConfigError
        If it is neither.
    """
    if place.is_file():
        about, table = _published(place)
        tree = parse_yaml(about.decode(), str(place))
    elif (place / CAMPAIGN_FILE).is_file():
        tree, table = read_tree(place / CAMPAIGN_FILE), read_table(place)
    else:
        raise ConfigError(f"{place}: not a campaign's folder: there is no {CAMPAIGN_FILE}")
    config = fill(CampaignConfig, tree["campaign"], str(place), "campaign.")
    flown_on = tuple(tree.get("flown_on", ()))
    return FlownCampaign(place, str(tree["name"]), config, str(tree.get("fingerprint")), flown_on, table)


def _published(file: Path) -> tuple[bytes, pa.Table]:
    try:
        table = pq.read_table(file)
    except (pa.ArrowInvalid, OSError) as error:
        raise ConfigError(f"{file}: cannot be read as Parquet: {error}") from None
    about: bytes | None = (table.schema.metadata or {}).get(_ABOUT)
    if about is None:
        raise ConfigError(f"{file}: no published rows of a campaign: its metadata do not say what it is of")
    return about, table


def publish(folder: Path, file: Path) -> None:
    """Writes a campaign folder's rows into one file, with what they are of in its metadata."""
    about = (folder / CAMPAIGN_FILE).read_bytes()
    file.parent.mkdir(parents=True, exist_ok=True)
    write_table(file, read_table(folder).replace_schema_metadata({_ABOUT: about}))


def unpublish(file: Path, folder: Path) -> int:
    """The reverse of `publish`, into a folder that is no campaign's yet; returns the number of rows."""
    about, table = _published(file)
    folder.mkdir(parents=True, exist_ok=True)
    write_table(folder / PARQUET, table)
    write_atomically(folder / CAMPAIGN_FILE, about)  # last: with it the folder is a campaign's
    return len(table)
