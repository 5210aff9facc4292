"""Questions to a front end in a process of its own, and its answers (docs/howto/front-end.md).

n looks, M tracks, L most beams of a track, c range cells. An answer is on the key of its question.
"""

from typing import Annotated, Any, Literal

from pydantic import Field

from cogradar.shared.protocol.fields import (
    MAX_RATE_HZ,
    Beams,
    Complexes,
    Factor,
    FloatLists,
    Floats,
    Index,
    Ints,
    Measured,
    Rate,
    UtcSeconds,
)
from cogradar.shared.protocol.messages import MAX_FAULT, Message

MAX_CHANNELS = 4096  # of an array, on each side
Incarnation = Annotated[str, Field(pattern=r"^[A-Za-z0-9_.-]{1,64}$")]


class Opening(Message):
    """A run begins, or goes on, at this front end: emulator -> front end, which answers with a Hello."""

    radar: dict[str, Any]  # complete, as `[radar]` of a scenario
    dwells: Annotated[int, Field(ge=1)]  # of the run, after the acquisition
    rate_hz: Rate  # dwells per second in real time; 0: in lockstep


class Hello(Message):
    """What a front end is: front end -> emulator, which compares it with its radar."""

    incarnation: Incarnation  # chosen by the process when it starts, another one after each start
    n_tx: Annotated[int, Field(ge=1, le=MAX_CHANNELS)]  # waveforms that it transmits
    n_rx: Annotated[int, Field(ge=1, le=MAX_CHANNELS)]  # channels that it receives
    hands_over: Literal["looks", "data"]  # cells that it tested itself, or Y, which the emulator tests
    max_rate_hz: Annotated[float, Field(gt=0, le=MAX_RATE_HZ)]  # dwells per second that it can make
    clock: Literal["none", "utc"]  # utc: each answer says when it was measured
    site: Annotated[str, Field(max_length=100, pattern=r"^[ -~]*$")] = ""  # where it stands, for people


class Transmit(Message):
    """Dwell k: what to radiate and which cells to test: emulator -> front end, which answers with a Received."""

    k: Index
    t: Index  # clock of the dwell; 0 during acquisition
    deadline_s: Annotated[float, Field(gt=0)]  # after the question: a later answer is not used
    isotropic: Annotated[float, Field(ge=0)]  # power spread evenly over all directions
    factor: Factor  # (n_tx, r) F, a column per beam: R = isotropic/n_tx I + F F^H
    bins: Ints  # (n,) nearest bin of each look
    nus: Floats  # (n,) direction of each look, ascending
    limits: Measured  # (n,) what the statistic is compared with
    first_cells: Ints  # (n,) number of the first range cell of each look,
    n_cells: Ints  # (n,) ... and how many there are from there on; 0: one cell for all ranges
    merged: Ints  # (n,) 1: of all such looks of a bin the largest statistic is reported; else 0
    range_cells: Ints  # (c,) numbers of all range cells of these looks, ascending; none: there are no range cells
    beams: Beams  # (M, L) bins lit for each track, brightest first; -1: no more, or acquisition
    beam_nus: FloatLists  # (M, L) directions of `beams`; 0 where there is none
    gates: FloatLists  # (M, 2) ranges that are tested for each track, km; (0, 0): all


class Received(Message):
    """What was measured in dwell k: looks; or Y, which then is the payload, and this message its attachment.

    A look or a range cell that is left out was not measured.
    """

    incarnation: Incarnation  # of the Hello
    k: Index  # of the question
    # Of looks, a row each, as in a Scan.
    bins: Ints | None = None  # (n,)
    statistic: Measured | None = None  # (n,) Wald-type statistic
    alpha_hat: Complexes | None = None  # (n,) estimated echo amplitude
    sigma_hat: Measured | None = None  # (n,) its standard deviation
    signature_power: Measured | None = None  # (n,) ||v||^2
    nus: Floats | None = None  # (n,) with steered cells, as all below
    limits: Measured | None = None  # (n,)
    ranges_km: Measured | None = None  # (n,) centre of the range cell; 0: there is none
    nu_hats: Floats | None = None  # (n,) measured direction of the echo,
    nu_sigmas: Measured | None = None  # (n,) ... its standard deviation; 0: not measured
    lost_km: Measured | None = None  # (v,) centres of range cells that were asked for and not received
    range_cells: Ints | None = None  # (c,) of Y, numbers of its range cells, in their order; none: Y of all ranges
    fault: Annotated[str, Field(max_length=MAX_FAULT)] | None = None  # why nothing was measured
    ended: bool = False  # there are no more dwells: the run is complete
    utc_s: UtcSeconds | None = None  # when it was measured, since 1970 in UTC
