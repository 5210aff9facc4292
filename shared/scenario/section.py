"""What every table of a scenario file has in common."""

from collections.abc import Collection

from pydantic import AfterValidator, BaseModel, ConfigDict


class Section(BaseModel):
    """A table of the scenario file: immutable, no unknown keys, no silent conversion."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)


def named_in(table: Collection[str]) -> AfterValidator:
    """A check of a name: it must name a row of a table of `cogradar.shared.scenario.tables`, or be one of these."""

    def check(name: str) -> str:
        if name not in table:
            raise ValueError(f"must be one of {', '.join(table)}")
        return name

    return AfterValidator(check)
