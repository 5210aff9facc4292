"""Which recorder leads each run, as far as a process has heard, and what was made of more than its journal has.

A recorder that was deposed, frozen or cut off, may acknowledge what the journal of its successor does not have: its
word is not heeded. An older journal that was put in place lacks dwells and orders that processes were told of. What
they made since then goes on to be sent, and would be taken for what is made anew. So in lockstep each message has a
stamp beside its bytes: the epoch that its sender has heard, and the revision of the journal that it may be made of.
In real time no dwell is repeated, and nothing has one.
"""

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, Self

from cogradar.shared.protocol.fields import MAX_EPOCH
from cogradar.shared.protocol.messages import Checkpoint, Command, Lead, Message, RunCancel, RunStart
from cogradar.shared.wire.codec import BadMessage

MAX_RUNS_HEARD = 8192  # whose epochs are kept
_PACKED = struct.Struct("<QQ")  # see Stamp
_ASKED = (RunStart, RunCancel, Command)  # of a run, whatever it has come to


class Stamp(NamedTuple):
    """What a message may be made of: two unsigned numbers of 8 bytes, little-endian, on the wire."""

    epoch: int
    revision: int

    def packed(self) -> bytes:
        """As it is on the wire."""
        return _PACKED.pack(*self)

    @classmethod
    def of(cls, packed: bytes) -> Self:
        """A stamp from the wire. Raises BadMessage."""
        if len(packed) != _PACKED.size:
            raise BadMessage(f"a stamp of {len(packed)} bytes, it has {_PACKED.size}")
        stamp = cls(*_PACKED.unpack(packed))
        if max(stamp) > MAX_EPOCH:
            raise BadMessage(f"a stamp of {max(stamp)}, at most {MAX_EPOCH}")
        return stamp


@dataclass
class _Heard:
    """What was heard of a run's recorder."""

    epoch: int
    revision: int = 0  # the highest one that reached this process, directly or by what others made of it
    told: int = 0  # the highest one that its checkpoints said here
    leads: Sequence[Lead] | None = None  # its own and those before it; None: only its epoch was heard
    is_in_lockstep: bool = False


class Epochs:
    """The highest epoch of each run, and what must not be heeded because of it."""

    def __init__(self) -> None:
        self._heard: dict[str, _Heard] = {}

    def say(self, message: Message) -> Stamp | None:
        """Note a message that this process sends; its stamp, if it has one."""
        if (epoch := vars(message).get("epoch")) is not None:
            self._fault_of_recorder(message, epoch)
            return None
        heard = self._heard.get(message.run)
        is_stamped = heard is not None and heard.is_in_lockstep and not isinstance(message, _ASKED)
        return Stamp(heard.epoch, heard.revision) if heard is not None and is_stamped else None

    def voids(self, message: Message) -> bool:
        """Whether a message says that what this process knows of its run is made of more than the journal has."""
        heard = self._heard.get(message.run)
        if not isinstance(message, Checkpoint) or message.rate_hz or heard is None or message.epoch <= heard.epoch:
            return False
        return heard.revision > _kept(message.leads, heard.epoch)

    def fault(self, message: Message, stamp: Stamp | None = None) -> str:
        """Why a message must be dropped; "": it may be heeded, and is from now on."""
        epoch = vars(message).get("epoch")
        if epoch is not None:
            return self._fault_of_recorder(message, epoch)
        return "" if stamp is None else self._fault_of(message.run, stamp)

    def _fault_of_recorder(self, message: Message, epoch: int) -> str:
        heard = self._heard_of(message.run, epoch)
        if epoch < heard.epoch:
            return f"{message.run}: of epoch {epoch}, another recorder of epoch {heard.epoch} leads it"
        if epoch > heard.epoch and heard.is_in_lockstep and not isinstance(message, Checkpoint):
            return _unheard(message.run, epoch)
        if epoch > heard.epoch:
            heard = self._heard[message.run] = _Heard(epoch, is_in_lockstep=heard.is_in_lockstep)
        return self._fault_of_checkpoint(heard, message) if isinstance(message, Checkpoint) else ""

    def _fault_of_checkpoint(self, heard: _Heard, checkpoint: Checkpoint) -> str:
        heard.leads, heard.is_in_lockstep = checkpoint.leads, not checkpoint.rate_hz
        if checkpoint.revision < heard.told and heard.is_in_lockstep and not checkpoint.ended:
            return f"{checkpoint.run}: it comes late, of revision {checkpoint.revision}; {heard.told} was told"
        heard.told, heard.revision = checkpoint.revision, max(heard.revision, checkpoint.revision)
        return ""

    def _fault_of(self, run: str, stamp: Stamp) -> str:
        heard = self._heard_of(run, stamp.epoch)
        if stamp.epoch > heard.epoch:
            return _unheard(run, stamp.epoch)
        kept = 0 if heard.leads is None else _kept(heard.leads, stamp.epoch)
        if stamp.epoch < heard.epoch and (heard.leads is None or stamp.revision > kept):
            return (
                f"{run}: made under epoch {stamp.epoch} of revision {stamp.revision} of its journal, which has been put"
                f" back to {kept}"
            )
        heard.revision = max(heard.revision, stamp.revision)
        return ""

    def _heard_of(self, run: str, epoch: int) -> _Heard:
        """What was heard of a run, which is the last to be forgotten now."""
        heard = self._heard.pop(run, None) or _Heard(epoch)
        if len(self._heard) >= MAX_RUNS_HEARD:
            del self._heard[next(iter(self._heard))]  # heard of longest ago
        self._heard[run] = heard
        return heard


def _kept(leads: Sequence[Lead], epoch: int) -> int:
    """Up to which revision the journal has what was told in an epoch, by the recorders that led the run after it.

    Nothing of an epoch that it does not know: another copy of it was led then, or it is longer ago than is kept.
    """
    is_known = any(lead.epoch == epoch for lead in leads)
    return min((lead.revision for lead in leads if lead.epoch > epoch), default=MAX_EPOCH) if is_known else 0


def _unheard(run: str, epoch: int) -> str:
    return f"{run}: of epoch {epoch}, whose recorder has not said here how far its journal is"
