"""What every table of a scenario file has in common."""

from pydantic import BaseModel, ConfigDict


class Section(BaseModel):
    """A table of the scenario file: immutable, no unknown keys, no silent conversion."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)
