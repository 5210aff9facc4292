"""What a router lets each certificate do, as Zenoh's access control has it: drawn from the topics at every start."""

from collections.abc import Sequence
from typing import Any

from cogradar.services.certs.names import holder_of, limit_of
from cogradar.shared.protocol.permissions import Act, permitted
from cogradar.shared.protocol.slots import ALL_SLOTS

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
    """Access control for these certificates: each may do what its role does in the system, others may do nothing.

    A role without a certificate is left out: an empty list of names would stand for everybody. Planners of the same
    slots are one subject.
    """
    subjects: dict[tuple[str, str], list[str]] = {}
    for name in names:
        subjects.setdefault((holder_of(name), limit_of(name)), []).append(name)
    rules, policies, listed = [], [], []
    for (holder, limit), of_names in subjects.items():
        subject = holder if limit == ALL_SLOTS else f"{holder}@{limit}"
        ids = []
        for act, keys in permitted(holder, limit).items():
            for flow, messages in _FLOWS[act]:
                ids.append(f"{subject}-{act}-{flow}")
                rules.append(
                    {"id": ids[-1], "permission": "allow", "flows": [flow], "messages": messages, "key_exprs": keys}
                )
        policies.append({"rules": ids, "subjects": [subject]})
        listed.append({"id": subject, "cert_common_names": of_names})
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": listed,
        "policies": policies,
    }
