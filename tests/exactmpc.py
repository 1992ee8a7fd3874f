"""The optimal command of a predictive controller in long arithmetic, and random programs to compare on.

Independent of the product: the program is condensed in the commands themselves, from the equations of `horizon`'s
header, in 600 bits, in which its condition does not matter; it is solved by the dual method of Goldfarb and Idnani
(1983), Mathematical Programming 27, 1, and the optimality conditions of what comes out are checked.
"""

import math

import numpy as np
from flint import arb, arb_mat, ctx

from synth.systems.statespace import StateSpace

TINY = 1e-40


def balls(M):
    M = np.atleast_2d(M)
    return arb_mat(*M.shape, [float(e) for e in M.ravel()])


def stacked(parts):
    return arb_mat([row for M in parts for row in M.tolist()])


class Reference:
    """minimise w'P w/2 + f'w subject to C w <= b at one measurement; w: commands in units of `unit`, slacks."""

    def __init__(self, p, phi, bits=600):
        self.bits, self.m, self.unit = bits, p.model.nu, p.unit
        with ctx.workprec(bits):
            self._condense(p, {name: phi[s] for name, s in p.parameters.items()})

    def _condense(self, p, given):
        n, m = p.model.B.shape
        N = p.Nc * m
        A, B, dt = balls(p.model.A), balls(p.model.B), arb(p.model.dt)
        constants = {k: balls(np.column_stack([np.zeros((v.size, N)), v])) for k, v in given.items()}
        x, d, r, h = (constants[name] for name in ("x", "d", "r", "h"))
        table = constants["inputs"].tolist()
        past = [arb_mat(table[i : i + m]) for i in range(0, len(table), m)]
        for u in past[: p.delay]:
            x, h = A * x + B * u + d, h - u * dt
        unit = np.diag(p.unit)
        planned = [balls(np.column_stack([np.kron(np.eye(p.Nc)[k], unit), np.zeros(m)])) for k in range(p.Nc)]
        acting, weights, errors = planned + [planned[-1]] * (p.Np - p.Nc), [], []
        states, stored = [], []
        for k, u in enumerate(acting):
            x, h = A * x + B * u + d, h - u * dt
            states.append(x)
            if k < p.Nc - 1 or k == p.Np - 1:
                stored.append(h)
            errors.append(r - x)
            weights.append(p.terminal if k == p.Np - 1 else p.Q)
        moves = (
            planned if p.form == "position" else [u - v for u, v in zip(planned, [past[-1], *planned], strict=False)]
        )
        J = arb_mat(N + 1, N + 1)
        for e, W in [*zip(errors, weights, strict=True), *((u, p.R) for u in moves)]:
            J = J + e.transpose() * (balls(W) * e)
        J = J * (1 / self._full_command(p, A, B))

        rows, bounds, slack = [], [], []
        for k in range(p.Nc):
            for i in range(m):
                row = [arb(0)] * N
                row[k * m + i] = arb(1)
                rows += [row, [-e for e in row]]
                bounds += [arb(p.umax[i]) / arb(p.unit[i]), -arb(p.umin[i]) / arb(p.unit[i])]
                slack += [None, None]
        channels = 0
        soft = [(states, i, p.ymin[i], p.ymax[i]) for i in range(n)]
        soft += [(stored, i, -p.hmax[i], p.hmax[i]) for i in range(m)]
        for values, i, low, high in soft:
            finite = [abs(limit) for limit in (low, high) if math.isfinite(limit)]
            scale = arb((max(finite) if finite else 1.0) or 1.0)
            for value in values:
                for sign, limit in ((1, high), (-1, low)):
                    if math.isfinite(limit):
                        row = [sign * value[i, j] / scale for j in range(N + 1)]
                        rows.append(row[:N])
                        bounds.append(sign * arb(limit) / scale - row[N])
                        slack.append(channels)
            channels += bool(finite)
        zeros = [arb(0)] * channels
        one = np.eye(channels, dtype=int).tolist()
        full = [
            row + ([arb(-e) for e in one[s]] if s is not None else zeros) for row, s in zip(rows, slack, strict=True)
        ]
        full += [[arb(0)] * N + [arb(-e) for e in one[i]] for i in range(channels)]
        self.C, self.b = arb_mat(full), arb_mat(len(full), 1, bounds + zeros)
        table = J.tolist()
        P = [row[:N] + zeros for row in table[:N]]
        P += [[arb(0)] * N + [arb(p.penalty) * e for e in one[i]] for i in range(channels)]
        self.P = arb_mat(P)
        self.f = arb_mat(N + channels, 1, [row[N] for row in table[:N]] + [arb(p.penalty)] * channels)
        self.commands, self.channels = N, channels

    @staticmethod
    def _full_command(p, A, B):
        """The largest eigenvalue of the cost of full command held for one sample of cost and Np of prediction."""
        G, unit = arb_mat(*p.model.B.shape), balls(np.diag(p.unit))
        H = unit * balls(p.R) * unit
        for k in range(p.Np):
            G = A * G + B * unit
            H = H + G.transpose() * (balls(p.Q if k < p.Np - 1 else p.terminal) * G)
        size = float(H.trace().mid())
        return arb(size) * arb(np.linalg.eigvalsh([[float(e) / size for e in row] for row in H.tolist()])[-1])

    def solve(self, near=None):
        """u_0 of the optimum, (m,).

        near : (N,) variables whose active rows are tried first; whatever they are, the optimum is the same
        """
        with ctx.workprec(self.bits):
            if near is not None and self._is_optimal_on(near):
                return self._command()
            inverse = self.P.inv()
            CP = self.C * inverse
            rows, columns = self.C.tolist(), CP.tolist()
            free = inverse * self.f * arb(-1)
            w, W, y = free, [], arb_mat(0, 1)
            while True:
                excess = [float(e.mid()) for e in (self.C * w - self.b).entries()]
                entering = int(np.argmax([0 if i in W else e for i, e in enumerate(excess)]))
                if entering in W or excess[entering] <= TINY:
                    break
                row, column, multiplier = arb_mat([rows[entering]]), arb_mat([columns[entering]]).transpose(), arb(0)
                while entering not in W:
                    step, share = column, arb_mat(0, 1)
                    if W:
                        active = arb_mat([columns[i] for i in W]).transpose()
                        share = (arb_mat([rows[i] for i in W]) * active).solve(arb_mat([rows[i] for i in W]) * column)
                        step = column - active * share
                    gain, length = (row * step)[0, 0], (row * column)[0, 0]
                    full = (row * w - self.b[entering, 0])[0, 0] / gain if gain > TINY * length else arb("inf")
                    blocking = [(y[i, 0] / share[i, 0], i) for i in range(len(W)) if share[i, 0] > TINY * length]
                    short, leaving = min(blocking, key=lambda e: e[0].mid(), default=(arb("inf"), -1))
                    t = full if full.mid() <= short.mid() else short
                    if not t.is_finite():
                        raise ArithmeticError("the program is infeasible, or more bits are needed")
                    w, multiplier = (w - step * t).mid(), multiplier + t
                    y = arb_mat([[e.mid()] for e in (y - share * t).entries()] + [[multiplier.mid()]])
                    W = [*W, entering]
                    if full.mid() > short.mid():
                        kept = [k for k in range(len(W) - 1) if k != leaving]
                        y, W = arb_mat(len(kept), 1, [y[k, 0] for k in kept]), [W[k] for k in kept]
            self._check(w, W, y)
            self.active, self.w = W, w
            return self._command()

    def _command(self):
        return np.array([float(self.w[i, 0].mid()) for i in range(self.m)]) * self.unit

    def _is_optimal_on(self, near):
        """Whether the rows that are active at `near`, less those with negative multipliers, are the optimum's."""
        distance = (self.C * balls(near).transpose() - self.b).entries()
        N, rows = self.P.nrows(), self.C.tolist()
        sizes = np.abs([[float(e) for e in row] for row in rows]) @ np.abs(near)
        W = [i for i, e in enumerate(distance) if abs(float(e)) < 1e-9 + 1e-13 * sizes[i]]
        while True:
            zeros = [arb(0)] * len(W)
            columns = arb_mat([rows[i] for i in W]).transpose().tolist() if W else [[]] * N
            system = [row + column for row, column in zip(self.P.tolist(), columns, strict=True)]
            system += [rows[i] + zeros for i in W]
            right = [-e for e in self.f.entries()] + [self.b[i, 0] for i in W]
            try:
                found = arb_mat(system).solve(arb_mat(len(right), 1, right)).mid().entries()
            except ZeroDivisionError:  # rows that depend on each other
                return False
            kept = [i for i, e in zip(W, found[N:], strict=True) if e > 0]
            if kept == W:
                break
            W = kept
        w, y = arb_mat(N, 1, found[:N]), arb_mat(len(W), 1, found[N:])
        if max(float(e.mid()) for e in (self.C * w - self.b).entries()) > TINY:
            return False
        self._check(w, W, y)
        self.active, self.w = W, w
        return True

    def _check(self, w, W, y):
        """Stationary, feasible, complementary, multipliers that are not negative: each to 1e-30 of its terms."""
        gradient, excess = self.P * w + self.f, (self.C * w - self.b).entries()
        if W:
            active = arb_mat([self.C.tolist()[i] for i in W]).transpose()
            gradient = gradient + active * y
        size = 1 + max(abs(float(e.mid())) for e in (*self.f.entries(), *(self.P * w).entries(), *y.entries()))
        assert max(float(abs(e).upper()) for e in gradient.entries()) <= 1e-30 * size
        assert max(float(e.upper()) for e in excess) <= 1e-30
        assert all(float(abs(excess[i]).upper()) <= 1e-30 for i in W)
        assert all(float(e.mid()) >= -1e-30 for e in y.entries())


def random_plant(rng, n, m, growth):
    """x+ = A x + B u with modes up to `growth` a sample."""
    blocks, k = np.zeros((n, n)), 0
    while k < n:
        radius = rng.uniform(1.0, growth) if rng.random() < 0.5 else rng.uniform(0.0, 1.0)
        if k + 1 < n and rng.random() < 0.4:
            c, s = radius * np.cos(a := rng.uniform(0, np.pi)), radius * np.sin(a)
            blocks[k : k + 2, k : k + 2] = [[c, s], [-s, c]]
            k += 2
        else:
            blocks[k, k] = radius * rng.choice([-1, 1], p=[0.2, 0.8])
            k += 1
    T = np.linalg.qr(rng.standard_normal((n, n)))[0] * rng.uniform(0.3, 3, n)
    A, B = T @ blocks @ np.linalg.inv(T), rng.standard_normal((n, m))
    return StateSpace(A, B, np.eye(n), np.zeros((n, m)), float(10 ** rng.uniform(-2, 1)))


def random_program(rng, largest=100, growth=1.5):
    """(model, arguments of `mpc`, measurement x, reference r, past inputs, disturbance)."""
    n, m = int(rng.integers(1, 7)), int(rng.integers(1, 3))
    model = random_plant(rng, n, m, growth)
    Np = int(np.exp(rng.uniform(0, np.log(largest + 0.99))))
    Nc = Np if rng.random() < 0.5 else int(rng.integers(1, Np + 1))
    C = rng.standard_normal((int(rng.integers(1, n + 1)), n))
    umax = 10 ** rng.uniform(-1, 1, m)
    options = {
        "Q": C.T @ C + 10 ** rng.uniform(-4, 0) * np.eye(n),
        "R": np.diag(10 ** rng.uniform(-3, 2, m)),
        "Np": Np,
        "Nc": Nc,
        "umin": -umax * rng.uniform(0.2, 1.5, m),
        "umax": umax,
        "form": str(rng.choice(["position", "velocity"])),
        "delay": int(rng.choice([0, 0, 1, 2])),
    }
    size = 10 ** rng.uniform(-3, 1)
    if rng.random() < 0.4:
        limit = size * 10 ** rng.uniform(-0.5, 1, n)
        options |= {"ymin": np.where(rng.random(n) < 0.5, -limit, -np.inf), "ymax": limit}
    if rng.random() < 0.2:
        options["hmax"] = model.dt * umax * 10 ** rng.uniform(0, 2)
    x = size * rng.standard_normal(n)
    r = x * 0 if rng.random() < 0.7 else 0.3 * size * rng.standard_normal(n)
    past = umax * rng.uniform(-0.2, 0.2, (max(options["delay"], 1), m))
    return model, options, x, r, past, 0.01 * size * rng.standard_normal(n)
