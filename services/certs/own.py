"""The certificate that this process shows. What its role has no part in the router drops without a word: we say so."""

import uuid
from collections.abc import Collection

from cogradar.services.certs.names import holder_of
from cogradar.services.errors import BadInput
from cogradar.shared.protocol.permissions import WATCHING
from cogradar.shared.protocol.slots import slots_of
from cogradar.shared.protocol.topics import Role
from cogradar.shared.wire.session import BadConfig, own_certificate

ASKING = (Role.OPERATOR, Role.METRICS, *WATCHING)  # roles that may ask metrics


def process_name(role: Role, name: str, endpoints: str) -> str:
    """Name of a process: its certificate's if it shows one, as the router lets it show no other; else its own.

    Raises BadInput if the slots in both disagree.
    """
    certificate = check(endpoints, (role,), side="listen" if role is Role.ROUTER else "connect")
    if not certificate:
        return name
    if "@" in name and slots_of(name) != (slots := slots_of(certificate)):
        raise BadInput(f"--name: behind @ must be {slots} as on the certificate, {certificate}; or leave it out")
    return certificate


def operator_name(endpoints: str, holders: Collection[str] = (Role.OPERATOR,)) -> str:
    """Name of a command's session: its certificate's, as of a process. Raises BadInput if it is another role's."""
    return check(endpoints, holders) or f"{Role.OPERATOR}-{uuid.uuid4().hex[:8]}"


def check(endpoints: str, holders: Collection[str], side: str = "connect") -> str:
    """The name on the certificate that is shown there; empty if none is, or one of an authority that is not ours.

    Raises BadInput if it is not of one of these roles.
    """
    certificate = shown(endpoints, side)
    if certificate is None:
        return ""
    from cogradar.services.certs import authority

    name = authority.name_on(certificate)
    if name and holder_of(name) not in holders:
        needed = " or ".join(f"{holder}.NAME" for holder in holders)
        raise BadInput(f"--zenoh-config: its certificate is {name}'s; this needs one of {needed}")
    return name


def shown(endpoints: str, side: str) -> bytes | None:
    """The certificate, PEM, that is shown at these endpoints; None if none is. Raises BadInput."""
    try:
        return own_certificate(endpoints.split(","), side)
    except BadConfig as error:
        raise BadInput(str(error)) from None
