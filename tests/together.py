"""What threads and processes design at the same time; a module of its own, so that spawned processes find it."""

from synth import StateSpace, mixsyn

G = StateSpace([[-1, 2], [0, -3]], [[0], [1]], [[1, 0]], [[0]])


def designed(W):
    """The bits of a controller for one weight."""
    K = mixsyn(G, W1=W, W2=1.0).controller
    return b"".join(M.tobytes() for M in K.matrices)
