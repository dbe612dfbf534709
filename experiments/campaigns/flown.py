"""A flown campaign, from its folder or from a file of published rows: its settings and its rows."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import pyarrow as pa
import pyarrow.parquet as pq
import yaml

from configs.loader import ConfigError, ConfigRecord, fill, load, parse_mapping
from experiments.campaigns.campaign import CampaignConfig
from experiments.campaigns.fingerprint import fingerprint
from experiments.campaigns.flight_row import SCHEMA
from experiments.campaigns.store import PARQUET, read_table, write_table
from onboard.cores import NUMPY
from runtime.files import write_atomically

CAMPAIGN_FILE: Final = "campaign.yaml"
_METADATA: Final = b"campaign.yaml"
"""Key of that file's content in the metadata of published rows."""


class About(ConfigRecord):
    """The content of CAMPAIGN_FILE."""

    name: str
    fingerprint: str
    """Of the settings they were flown with."""
    seeds: int
    """Number of seeds per point in the latest call."""
    core: str = NUMPY
    """The onboard core of all flights, one of onboard.cores.CORES."""
    flown_on: tuple[str, ...] = ()
    """One line for each machine, set of versions and commit."""
    campaign: dict[str, Any]
    """The campaign as it was flown."""

    def file_content(self) -> bytes:
        """Return the content of CAMPAIGN_FILE."""
        tree = self.model_dump(mode="json")
        return yaml.safe_dump(tree, sort_keys=False, allow_unicode=True, width=110).encode()

    def check_settings(self, campaign: CampaignConfig, where: str, advice: str) -> None:
        """Raises ConfigError, with the advice, if `campaign` has other settings today than those of the flights."""
        if self.fingerprint != fingerprint(campaign, self.core):
            raise ConfigError(
                f"{where}: its flights were made with other settings: campaign or configs have changed since; {advice}"
            )


@dataclass(frozen=True)
class FlownCampaign:
    """The rows of a campaign, and its settings."""

    place: Path
    """Folder or file."""
    about: About
    config: CampaignConfig
    """The campaign as it was flown."""
    table: pa.Table
    """Columns of experiments.campaigns.flight_row.SCHEMA."""


def is_campaign(folder: Path) -> bool:
    """Return whether a folder is a campaign's."""
    return (folder / CAMPAIGN_FILE).exists()


def read_about(place: Path) -> About:
    """Read the settings from a campaign's folder or a file of published rows.

    Raises
    ------
    ConfigError
        If `place` is neither, or is damaged.
    """
    if place.is_file():
        return fill(About, parse_mapping(_published_about(place), str(place)), str(place))
    if not is_campaign(place):
        raise ConfigError(f"{place}: not a campaign's folder: there is no {CAMPAIGN_FILE}")
    return load(About, place / CAMPAIGN_FILE)


def _published_about(file: Path) -> str:
    try:
        content: bytes | None = (pq.read_schema(file).metadata or {}).get(_METADATA)
        if content is None:
            raise ConfigError(f"{file}: no published rows of a campaign: its metadata name no campaign")
        return content.decode()
    except (OSError, UnicodeDecodeError, pa.lib.ArrowException) as error:
        raise ConfigError(f"{file}: cannot be read: {error}") from None


def read_flown(place: Path) -> FlownCampaign:
    """Read a campaign's folder or a file of published rows. Raises ConfigError as `read_about` does."""
    about = read_about(place)
    config = fill(CampaignConfig, about.campaign, str(place), "campaign.")
    try:
        table = pq.read_table(place, schema=SCHEMA) if place.is_file() else read_table(place)
    except (OSError, pa.lib.ArrowException) as error:
        raise ConfigError(f"{place}: its rows cannot be read: {error}") from None
    if any(table.column(name).null_count for name in ("key", "seed", "error", "trace_sha256")):
        raise ConfigError(f"{place}: its rows are not flights of a campaign")
    return FlownCampaign(place, about, config, table)


def publish(folder: Path, file: Path) -> None:
    """Write the rows of a campaign's folder into one file, with the campaign file in its metadata."""
    file.parent.mkdir(parents=True, exist_ok=True)
    content = (folder / CAMPAIGN_FILE).read_bytes()
    write_table(file, read_table(folder).replace_schema_metadata({_METADATA: content}))


def unpublish(file: Path, folder: Path) -> int:
    """Write published rows into a new folder of a campaign; return the number of rows."""
    table = pq.read_table(file)
    folder.mkdir(parents=True, exist_ok=True)
    write_table(folder / PARQUET, table)
    write_atomically(
        folder / CAMPAIGN_FILE, table.schema.metadata[_METADATA]
    )  # last: this makes it a campaign's folder
    return len(table)
