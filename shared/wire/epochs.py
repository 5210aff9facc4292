"""Which recorder leads each run, as far as a process has heard, and what was made of more than its journal has.

A recorder that was deposed, frozen or cut off, may acknowledge what the journal of its successor does not have: its
word is not heeded. An older journal that was put in place lacks dwells and orders that processes were told of. What
they made since then goes on to be sent, and would be taken for what is made anew. So in lockstep each message has a
stamp beside its bytes: the epoch that its sender has heard, and the revision of the journal that it may be made of.
In real time no dwell is repeated, and nothing has one.
"""

import struct
from dataclasses import dataclass
from typing import NamedTuple, Self

from cogradar.shared.protocol.fields import MAX_EPOCH
from cogradar.shared.protocol.messages import Checkpoint, Command, Message, RunCancel, RunStart
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
class _Lead:
    """What was heard of a run's recorder."""

    epoch: int
    revision: int = 0  # the highest one that reached this process, directly or by what others made of it
    told: int = 0  # the highest one that its checkpoints said here
    opened: int | None = None  # revision with which the recorder began to lead; None: only its epoch was heard
    is_in_lockstep: bool = False


class Epochs:
    """The highest epoch of each run, and what must not be heeded because of it."""

    def __init__(self) -> None:
        self._leads: dict[str, _Lead] = {}

    def say(self, message: Message) -> Stamp | None:
        """Note a message that this process sends; its stamp, if it has one."""
        if (epoch := vars(message).get("epoch")) is not None:
            self._fault_of_recorder(message, epoch)
            return None
        lead = self._leads.get(message.run)
        is_stamped = lead is not None and lead.is_in_lockstep and not isinstance(message, _ASKED)
        return Stamp(lead.epoch, lead.revision) if lead is not None and is_stamped else None

    def voids(self, message: Message) -> bool:
        """Whether a message says that what this process knows of its run is made of more than the journal has."""
        lead = self._leads.get(message.run)
        if not isinstance(message, Checkpoint) or message.rate_hz or lead is None or message.epoch <= lead.epoch:
            return False
        return lead.revision > message.opened

    def fault(self, message: Message, stamp: Stamp | None = None) -> str:
        """Why a message must be dropped; "": it may be heeded, and is from now on."""
        epoch = vars(message).get("epoch")
        if epoch is not None:
            return self._fault_of_recorder(message, epoch)
        return "" if stamp is None else self._fault_of(message.run, stamp)

    def _fault_of_recorder(self, message: Message, epoch: int) -> str:
        lead = self._heard_of(message.run, epoch)
        if epoch < lead.epoch:
            return f"{message.run}: of epoch {epoch}, another recorder of epoch {lead.epoch} leads it"
        if epoch > lead.epoch and lead.is_in_lockstep and not isinstance(message, Checkpoint):
            return _unheard(message.run, epoch)
        if epoch > lead.epoch:
            lead = self._leads[message.run] = _Lead(epoch, is_in_lockstep=lead.is_in_lockstep)
        return self._fault_of_checkpoint(lead, message) if isinstance(message, Checkpoint) else ""

    def _fault_of_checkpoint(self, lead: _Lead, checkpoint: Checkpoint) -> str:
        lead.opened, lead.is_in_lockstep = checkpoint.opened, not checkpoint.rate_hz
        if checkpoint.revision < lead.told and lead.is_in_lockstep and not checkpoint.ended:
            return f"{checkpoint.run}: it comes late, of revision {checkpoint.revision}; {lead.told} was told"
        lead.told, lead.revision = checkpoint.revision, max(lead.revision, checkpoint.revision)
        return ""

    def _fault_of(self, run: str, stamp: Stamp) -> str:
        lead = self._heard_of(run, stamp.epoch)
        if stamp.epoch > lead.epoch:
            return _unheard(run, stamp.epoch)
        if stamp.epoch < lead.epoch and (lead.opened is None or stamp.revision > lead.opened):
            return (
                f"{run}: made under epoch {stamp.epoch} of revision {stamp.revision} of its journal, which has been put"
                f" back to {lead.opened}"
            )
        lead.revision = max(lead.revision, stamp.revision)
        return ""

    def _heard_of(self, run: str, epoch: int) -> _Lead:
        """What was heard of a run, which is the last to be forgotten now."""
        lead = self._leads.pop(run, None) or _Lead(epoch)
        if len(self._leads) >= MAX_RUNS_HEARD:
            del self._leads[next(iter(self._leads))]  # heard of longest ago
        self._leads[run] = lead
        return lead


def _unheard(run: str, epoch: int) -> str:
    return f"{run}: of epoch {epoch}, whose recorder has not said here how far its journal is"
