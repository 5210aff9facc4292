"""What the description cannot say of a question: schemathesis is told here."""

from typing import Any

import schemathesis


@schemathesis.hook
def filter_query(context: schemathesis.HookContext, query: Any) -> bool:
    """Whether the dwells are in order, as far as they are numbers: a schema compares no parts of a text."""
    del context
    first, _, last = str((query or {}).get("dwells", "")).partition(":")
    return not (first.isdecimal() and last.isdecimal() and int(first) > int(last))
