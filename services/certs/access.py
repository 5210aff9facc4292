"""What a router lets each certificate do, as Zenoh's access control has it: drawn from the topics at every start."""

from collections.abc import Sequence
from typing import Any

from cogradar.services.certs.names import holder_of, limit_of
from cogradar.shared.protocol.permissions import Act, permitted
from cogradar.shared.protocol.slots import ALL_SLOTS
from cogradar.shared.protocol.topics import FRONT_END

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
_OWN = (Act.SHOW, Act.ANSWER)  # what a process does under its own name


def access_control(names: Sequence[str]) -> dict[str, Any]:
    """Access control for these certificates: each may do what its role does in the system, others may do nothing.

    A role without a certificate is left out: an empty list of names would stand for everybody. Each certificate is a
    subject. It shows itself, and answers for itself, under its own name only; all else is ruled for its role and limit.
    """
    alike: dict[tuple[str, str], list[str]] = {}
    for name in names:
        alike.setdefault((holder_of(name), limit_of(name)), []).append(name)
    rules, policies = list[dict[str, Any]](), list[dict[str, Any]]()

    def allow(of: str, subjects: Sequence[str], permissions: dict[Act, tuple[str, ...]]) -> None:
        ids = []
        for act, keys in permissions.items():
            for flow, messages in _FLOWS[act]:
                ids.append(f"{of}-{act}-{flow}")
                rules.append(
                    {"id": ids[-1], "permission": "allow", "flows": [flow], "messages": messages, "key_exprs": keys}
                )
        if ids:
            policies.append({"rules": ids, "subjects": subjects})

    for (holder, limit), of_names in alike.items():
        of_all = permitted(holder, limit)
        is_named = holder != FRONT_END  # of a front end the limit is its name
        shared = {act: keys for act, keys in of_all.items() if not (is_named and act in _OWN)}
        allow(holder if limit == ALL_SLOTS else f"{holder}@{limit}", of_names, shared)
        for name in of_names if is_named else ():
            own = permitted(holder, limit, name)
            allow(name, [name], {act: keys for act, keys in own.items() if act in _OWN})
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": [{"id": name, "cert_common_names": [name]} for name in names],
        "policies": policies,
    }
