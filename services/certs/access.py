"""What a router lets each certificate do, as Zenoh's access control has it: drawn from the topics at every start."""

from collections.abc import Sequence
from typing import Any

from services.certs.names import holder_of
from shared.protocol.permissions import Act, permitted

# What Zenoh calls each act, as the router sees it: in what comes from the process, and in what goes to it.
_FLOWS: dict[Act, tuple[tuple[str, tuple[str, ...]], ...]] = {
    Act.SEND: (("ingress", ("put",)),),
    Act.READ: (("ingress", ("declare_subscriber",)), ("egress", ("put",))),
    Act.ASK: (("ingress", ("query",)), ("egress", ("reply",))),
    Act.HEAR: (("egress", ("query",)),),
    Act.ANSWER: (("ingress", ("declare_queryable", "reply")),),
    Act.SHOW: (("ingress", ("liveliness_token",)),),
    Act.SEE: (("ingress", ("liveliness_query", "declare_liveliness_subscriber")), ("egress", ("liveliness_token",))),
}


def access_control(names: Sequence[str]) -> dict[str, Any]:
    """Access control for these certificates: each may do what its role's part in the system is, nobody else anything.

    A role without a certificate is left out: an empty list of names would stand for everybody.
    """
    holders: dict[str, list[str]] = {}
    for name in names:
        holders.setdefault(holder_of(name), []).append(name)
    rules, policies = [], []
    for holder in holders:
        ids = []
        for act, keys in permitted(holder).items():
            for flow, messages in _FLOWS[act]:
                ids.append(f"{holder}-{act}-{flow}")
                rules.append(
                    {"id": ids[-1], "permission": "allow", "flows": [flow], "messages": messages, "key_exprs": keys}
                )
        policies.append({"rules": ids, "subjects": [holder]})
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": [{"id": holder, "cert_common_names": listed} for holder, listed in holders.items()],
        "policies": policies,
    }
