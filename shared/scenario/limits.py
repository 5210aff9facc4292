"""How much memory a scenario asks of a planner."""

MAX_PLANNER_BYTES = 2 * 10**9  # of one search tree, and of the beliefs of a planner that owns every track


def tree_bytes(n_sim: int, n_action: int) -> int:
    """Most that a search of so many simulations and actions allocates, whatever its depth.

    Per simulation a node, a block of edges of 12 bytes each, a root of a visit count, and two to four slots of the hash
    table, a power of two. There is one tree at a time: it is dropped with the decision.
    """
    n_slot = 1 << max(4, (2 * n_sim + 1).bit_length())
    return n_sim * (48 + 12 * n_action) + 32 + 8 * n_action + 24 + 12 * n_slot


def beliefs_bytes(n_particle: int, n_target: int) -> int:
    """Most that the beliefs of all targets take, and an update's work.

    Three per track: now, at its last detection, and as it will be before the next scan.
    """
    return 32 * n_particle * (3 * n_target + 8)
