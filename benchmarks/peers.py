"""One control step beside those of others: the same tracking problem, horizon, limits and states, in one sitting.

    python benchmarks/peers.py [--steps 600] [--rounds 5] [--only step,estimator,loops,cost] [--json]

It needs the extra ``bench``; peers that are not installed are named and left out. Two problems, each with 30 predicted
periods of 0.05 s, 10 free moves, limits on moves and angle, at a speed that changes with every step:

step       the paper's model, its state as measured: form the QP and solve it
estimator  the model with lag and dead time, behind a Kalman filter; peers all have the same one in NumPy

Peers come in two forms: *plain* forms every matrix at each step, as most projects do; *tabulated* has all matrices, the
filter's gain and a solver that is set up already at nodes 0.1 m/s apart, and starts warm. CPU time of the thread in
microseconds; rounds are interleaved, and of each step the least of all rounds counts, so that other work on the machine
does not. `off`: largest difference (rad) of the first move from a solution of the same QP in extended precision.
"""

from __future__ import annotations

import argparse
import gc
import json
import logging
import os
import time
import warnings
from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple

import numpy as np
from scipy import sparse
from scipy.linalg import expm, solve_discrete_are
from tools.bench import SEARCH, _machine, one_blas_thread

import adaptrack as at
from adaptrack.control.controllers import Command, Limits, Tuning, informed_tuning
from adaptrack.control.kalman import KalmanFilter
from adaptrack.control.models import PathModel, SingleTrackModel
from adaptrack.control.scheduling import Learned, Sugeno
from adaptrack.core.synthesis.car import wind_turn
from adaptrack.scenario import random_drive

PERIOD, HORIZON, MOVES = 0.05, 30, 10
LIMITS = Limits(move=(-0.025, 0.025), angle=(-np.pi / 6, np.pi / 6))
GRID = 0.1
"""m/s, between the nodes of the tables."""
SLOW = 150
"""Steps that a peer is given whose step takes milliseconds."""
FIRST, UNSEEN = 9_400_000, 9_500_000
CAR = at.load_vehicle("paper")
TUNING = Tuning(HORIZON, MOVES, 1.0, informed_tuning("road", PERIOD).R)

SUMS = np.tril(np.ones((MOVES, MOVES)))
PHI = np.subtract.outer(np.arange(HORIZON), np.arange(MOVES))


# -- the problem, in NumPy --------------------------------------------------------------------------------------------
class Matrices(NamedTuple):
    """What a speed alone decides."""

    a: Any
    """(n, n)"""
    b: Any
    """(n,)"""
    free: Any
    """(HORIZON, n) F of the increments"""
    pull: Any
    """(MOVES, HORIZON) -2 Phi' Q"""
    hessian: Any
    f: Any = None
    """(7, 7) of the filter, with b of 7"""
    gain: Any = None
    """(7, 4) of the filter in its steady state"""


def discrete(a: Any, b: Any) -> tuple[Any, Any]:
    """Zero-order hold over a period."""
    n = len(b)
    block = np.zeros((n + 1, n + 1))
    block[:n, :n], block[:n, n] = a, b
    block = expm(block * PERIOD)
    return block[:n, :n], block[:n, n]


def formed(a: Any, b: Any, of_next: bool) -> tuple[Any, Any, Any]:
    """F of the increments, -2 Phi' Q and E; of_next: of the increments to come, not of the last ones."""
    row, total = np.zeros(len(b)), np.zeros(len(b))
    row[-1] = 1.0
    free, step, height = np.empty((HORIZON, len(b))), np.empty(HORIZON), 0.0
    for j in range(HORIZON):
        height += row @ b
        step[j] = height
        following = row @ a
        total = total + (row if of_next else following)
        free[j], row = total, following
    phi = np.where(PHI >= 0, step[PHI], 0.0)
    pull = -2.0 * TUNING.Q * np.ascontiguousarray(phi.T)
    return free, pull, 2.0 * TUNING.R * np.eye(MOVES) - pull @ phi


class AsMeasured:
    """The paper's model; its increments are those of the measured state."""

    def __init__(self) -> None:
        self.model = SingleTrackModel(CAR, PERIOD)
        self.rest()

    def rest(self) -> None:
        """Before the first step."""
        self.previous: Any = None

    def matrices(self, speed: float, gain: bool = False) -> Matrices:
        """At a speed (m/s)."""
        a, b, _ = self.model.continuous(max(speed, 1.0))
        a, b = discrete(a, b[:, 0])
        return Matrices(a, b, *formed(a, b, False))

    def state(self, m: Matrices, measured: Any, command: float) -> tuple[Any, float]:
        """Increments (n,) and y (m)."""
        change = measured - self.previous if self.previous is not None else np.zeros(4)
        self.previous = measured
        return change, measured[3]


class Filtered(AsMeasured):
    """The model with lag and dead time; its state from a Kalman filter with two disturbances."""

    H = np.zeros((4, 7))
    H[[0, 1, 2, 3], [0, 1, 2, 4]] = 1.0

    def __init__(self) -> None:
        mpc = at.MPC(CAR, profile="road")
        assert isinstance(mpc.model, PathModel)
        assert isinstance(mpc.estimator, KalmanFilter)
        self.model, drifts = mpc.model, mpc.estimator.drifts
        assert abs(self.model.dead_time - PERIOD) < 1e-9  # one period of computation
        own = [getattr(drifts, name) ** 2 for name in self.model.states]
        wind = drifts.wind * np.array([1.0, wind_turn(CAR.numbers)])
        self.Q = np.zeros((7, 7))
        self.Q[:5, :5], self.Q[5:, 5:] = np.diag(own), np.diag([drifts.side**2, drifts.turn**2]) + np.outer(wind, wind)
        self.Q *= PERIOD
        self.R = np.diag(mpc.estimator.variances()[:4])
        self.rest()

    def rest(self) -> None:
        self.z: Any = None
        self.sent = 0.0

    def matrices(self, speed: float, gain: bool = False) -> Matrices:
        a, inputs = self.model.continuous(max(speed, 1.0))
        whole, column = np.zeros((7, 7)), np.zeros(7)
        whole[:5, :5], whole[:5, 5:], column[:5] = a, inputs[:, 1:3], inputs[:, 0]
        f, b = discrete(whole, column)
        known = None
        if gain:
            P = solve_discrete_are(f.T, self.H.T, self.Q, self.R)
            known = np.linalg.solve(self.H @ P @ self.H.T + self.R, self.H @ P).T
        return Matrices(f[:5, :5], b, *formed(f[:5, :5], b[:5], True), f, known)

    def state(self, m: Matrices, measured: Any, command: float) -> tuple[Any, float]:
        if self.z is None:
            self.z, self.P = np.zeros(7), np.diag([0.01, 0.01, 0.01, 1e-4, 0.01, 0.09, 0.09])
            self.z[[0, 1, 2, 4]], self.sent = measured, command
        else:  # the command of two periods ago has acted
            self.z = m.f @ self.z + m.b * self.sent
            gain = m.gain
            if gain is None:
                self.P = m.f @ self.P @ m.f.T + self.Q
                gain = np.linalg.solve(self.H @ self.P @ self.H.T + self.R, self.H @ self.P).T
                self.P = self.P - gain @ (self.H @ self.P)
            self.z = self.z + gain @ (measured - self.H @ self.z)
            self.sent = command
        ahead = m.f @ self.z + m.b * command
        return (m.f @ ahead + m.b * command - ahead)[:5], ahead[4]


# -- the solvers of others --------------------------------------------------------------------------------------------
class Daqp:
    """DAQP; a workspace for each node."""

    name = "DAQP"
    TIGHT: ClassVar = {"primal_tol": 1e-9, "dual_tol": 1e-12}

    def __init__(self) -> None:
        import daqp

        self.library, self.sense = daqp, np.zeros(2 * MOVES, dtype=np.int32)

    def plain(self, E: Any, K: Any, low: Any, high: Any) -> Any:
        return self.library.solve(E, K, SUMS, high, low, self.sense, **self.TIGHT)[0]

    def node(self, E: Any) -> Any:
        model, wide = self.library.Model(), np.full(2 * MOVES, 1.0)
        model.settings = {**model.settings, **self.TIGHT}
        kept = np.array(E), np.zeros(MOVES), SUMS.copy(), wide, -wide, self.sense.copy()  # it does not copy them
        model.setup(*kept)
        return model, kept

    def warm(self, node: Any, E: Any, K: Any, low: Any, high: Any) -> Any:
        model, (_, f, _, upper, lower, _) = node
        f[:], upper[:], lower[:] = K, high, low
        model.update(f=f, bupper=upper, blower=lower)
        return model.solve()[0]


class Osqp:
    """OSQP to 1e-6; an instance for each node, started from the last solution."""

    name = "OSQP"
    TIGHT: ClassVar = {"eps_abs": 1e-6, "eps_rel": 1e-6, "verbose": False, "max_iter": 20_000}
    ROWS = sparse.csc_matrix(np.vstack([np.eye(MOVES), SUMS]))

    def __init__(self) -> None:
        import osqp

        self.library, self.last = osqp, None

    def _set_up(self, E: Any, K: Any, low: Any, high: Any) -> Any:
        problem = self.library.OSQP()
        problem.setup(P=sparse.csc_matrix(np.triu(E)), q=K, A=self.ROWS, l=low, u=high, **self.TIGHT)
        return problem

    def plain(self, E: Any, K: Any, low: Any, high: Any) -> Any:
        return self._set_up(E, K, low, high).solve(raise_error=False).x

    def node(self, E: Any) -> Any:
        return self._set_up(E, np.zeros(MOVES), np.full(2 * MOVES, -1.0), np.ones(2 * MOVES))

    def warm(self, node: Any, E: Any, K: Any, low: Any, high: Any) -> Any:
        node.update(q=K, l=low, u=high)
        if self.last is not None:
            node.warm_start(x=self.last[0], y=self.last[1])
        found = node.solve(raise_error=False)
        self.last = found.x, found.y
        return found.x


class Piqp:
    """PIQP, dense, with its own tolerances; an instance for each node."""

    name = "PIQP"

    def __init__(self) -> None:
        import piqp

        self.library, self.rows = piqp, np.asfortranarray(SUMS)

    def plain(self, E: Any, K: Any, low: Any, high: Any) -> Any:
        solver = self.library.DenseSolver()
        n = MOVES
        solver.setup(E, K, None, None, self.rows, low[n:], high[n:], low[:n], high[:n])
        solver.solve()
        return solver.result.x

    def node(self, E: Any) -> Any:
        solver, n, wide = self.library.DenseSolver(), MOVES, np.ones(MOVES)
        solver.setup(E, np.zeros(n), None, None, self.rows, -wide, wide, -wide, wide)
        return solver

    def warm(self, node: Any, E: Any, K: Any, low: Any, high: Any) -> Any:
        n = MOVES
        node.update(c=K, h_l=low[n:], h_u=high[n:], x_l=low[:n], x_u=high[:n])
        node.solve()
        return node.result.x


class QpOases:
    """qpOASES through CasADi."""

    name = "CasADi + qpOASES"

    def __init__(self) -> None:
        import casadi as ca

        dense = {"h": ca.Sparsity.dense(MOVES, MOVES), "a": ca.Sparsity.dense(MOVES, MOVES)}
        self.qp = ca.conic("qp", "qpoases", dense, {"printLevel": "none", "error_on_fail": False})

    def plain(self, E: Any, K: Any, low: Any, high: Any) -> Any:
        n = MOVES
        found = self.qp(h=E, g=K, a=SUMS, lbx=low[:n], ubx=high[:n], lba=low[n:], uba=high[n:])
        return np.asarray(found["x"])[:, 0]

    def node(self, E: Any) -> Any:
        return None

    def warm(self, node: Any, E: Any, K: Any, low: Any, high: Any) -> Any:
        return self.plain(E, K, low, high)


class Cvxpy:
    """CVXPY with Clarabel; one parametrised problem (disciplined parametrised programming)."""

    name = "CVXPY + Clarabel"
    slow = True

    def __init__(self) -> None:
        import cvxpy as cp

        x = cp.Variable(MOVES)
        self.root, self.K = cp.Parameter((MOVES, MOVES)), cp.Parameter(MOVES)
        self.low, self.high = cp.Parameter(2 * MOVES), cp.Parameter(2 * MOVES)
        rows = np.vstack([np.eye(MOVES), SUMS]) @ x
        cost = 0.5 * cp.sum_squares(self.root @ x) + self.K @ x
        self.x, self.solver = x, cp.CLARABEL
        self.problem = cp.Problem(cp.Minimize(cost), [rows >= self.low, rows <= self.high])

    def plain(self, E: Any, K: Any, low: Any, high: Any) -> Any:
        self.root.value, self.K.value, self.low.value, self.high.value = np.linalg.cholesky(E).T, K, low, high
        self.problem.solve(solver=self.solver)
        return self.x.value


SOLVERS = (Daqp, Osqp, Piqp, QpOases, Cvxpy)


# -- the controllers --------------------------------------------------------------------------------------------------
class Peer(at.Controller):
    """A controller in NumPy around a solver of others; drives in `simulate` as well."""

    period = PERIOD

    def __init__(self, problem: AsMeasured, solver: Any, tabulated: bool, speeds: tuple[float, float]) -> None:
        self.problem, self.solver, self.tabulated = problem, solver, tabulated
        self.name = f"{solver.name}, {'tabulated' if tabulated else 'plain'}"
        if tabulated:
            self.first = np.floor(speeds[0] / GRID)
            nodes = np.arange(self.first, np.ceil(speeds[1] / GRID) + 1) * GRID
            self.table = [problem.matrices(max(float(v), 1.0), gain=True) for v in nodes]
            self.nodes = [solver.node(m.hessian) for m in self.table]
        self.reset()

    def reset(self) -> None:
        """Before the first step."""
        self.angle = 0.0
        self.low, self.high = np.full(2 * MOVES, LIMITS.move[0]), np.full(2 * MOVES, LIMITS.move[1])
        self.problem.rest()

    def describe(self) -> dict[str, Any]:
        """The configuration."""
        return {"name": self.name, "tuning": {}}

    def step(self, state: Any, speed: float, reference: Any, variables: Any = None) -> Any:
        """One control step; the answer has `angle` and `move` (rad)."""
        node = 0
        if self.tabulated:
            node = min(max(round(speed / GRID - self.first), 0), len(self.table) - 1)
            m = self.table[node]
        else:
            m = self.problem.matrices(speed)
        change, y = self.problem.state(m, state, self.angle)
        ahead = reference[1 if type(self.problem) is AsMeasured else 2 :][:HORIZON]
        if len(ahead) < HORIZON:
            ahead = np.append(ahead, np.full(HORIZON - len(ahead), reference[-1]))
        K = m.pull @ (ahead - y - m.free @ change)
        low, high = self.low, self.high
        low[MOVES:], high[MOVES:] = LIMITS.angle[0] - self.angle, LIMITS.angle[1] - self.angle
        if self.tabulated:
            x = self.solver.warm(self.nodes[node], m.hessian, K, low, high)
        else:
            x = self.solver.plain(m.hessian, K, low, high)
        self.posed = m.hessian, K, low, high
        move = float(x[0])
        self.angle += move
        return Command(self.angle, move, False, (), {})


class DoMpc:
    """do-mpc (IPOPT) on a discrete model with the matrices of each step; all moves free, it has no Nc."""

    name, period, slow, tabulated = "do-mpc", PERIOD, True, False

    def __init__(self, problem: AsMeasured) -> None:
        import casadi as ca
        import do_mpc

        self.problem, n = problem, problem.model.n
        self.n = n
        model = do_mpc.model.Model("discrete")
        x, y = model.set_variable("_x", "change", (n, 1)), model.set_variable("_x", "y")
        u_last, move = model.set_variable("_x", "u"), model.set_variable("_u", "move")
        a, b = model.set_variable("_tvp", "a", (n, n)), model.set_variable("_tvp", "b", (n, 1))
        ref = model.set_variable("_tvp", "ref")
        of_next = type(problem) is not AsMeasured
        # the increments of the last period, or those of the next one, to which the move is still to be added
        after = x + b * move if of_next else ca.mtimes(a, x) + b * move
        model.set_rhs("change", ca.mtimes(a, after) if of_next else after)
        model.set_rhs("y", y + after[n - 1])
        model.set_rhs("u", u_last + move)
        model.setup()
        mpc = do_mpc.controller.MPC(model)
        mpc.settings.n_horizon, mpc.settings.t_step, mpc.settings.store_full_solution = HORIZON, PERIOD, False
        mpc.settings.nlpsol_opts = {"ipopt.print_level": 0, "print_time": 0, "ipopt.sb": "yes"}
        miss = TUNING.Q * (y - ref) ** 2
        mpc.set_objective(mterm=TUNING.Q * (y - model.tvp["ref"]) ** 2, lterm=miss + TUNING.R * move**2)
        mpc.bounds["lower", "_u", "move"], mpc.bounds["upper", "_u", "move"] = LIMITS.move
        mpc.bounds["lower", "_x", "u"], mpc.bounds["upper", "_x", "u"] = LIMITS.angle
        self.told = mpc.get_tvp_template()
        mpc.set_tvp_fun(lambda now: self.told)
        mpc.setup()
        self.mpc = mpc
        self.reset()

    def reset(self) -> None:
        """Before the first step."""
        self.angle, self.begun = 0.0, False
        self.problem.rest()

    def step(self, state: Any, speed: float, reference: Any, variables: Any = None) -> Any:
        """One control step."""
        m = self.problem.matrices(speed)
        change, y = self.problem.state(m, state, self.angle)
        first = 0 if type(self.problem) is AsMeasured else 1
        for k in range(HORIZON + 1):
            self.told["_tvp", k, "a"], self.told["_tvp", k, "b"] = m.a, m.b[: self.n]
            self.told["_tvp", k, "ref"] = reference[min(first + k, len(reference) - 1)]
        x0 = np.concatenate([change, [y, self.angle]])
        if not self.begun:
            self.mpc.x0 = x0
            self.mpc.set_initial_guess()
            self.begun = True
        move = float(self.mpc.make_step(x0).item())
        self.angle += move
        return Command(self.angle, move, False, (), {})


# -- what is recorded -------------------------------------------------------------------------------------------------
class Recording(at.MPC):
    """Keeps what it is given."""

    def reset(self) -> None:
        """Forget the past."""
        self.given: list[tuple[Any, float, Any]] = []
        super().reset()

    def step(self, state: Any, speed: float, reference: Any, variables: Any = None, road: Any = None) -> Any:
        """As the MPC."""
        self.given.append((np.array(state[:4]), speed, np.array(reference[:64])))
        return super().step(state, speed, reference, variables)


def ours(estimating: bool, kind: type = at.MPC, scheduler: Any = None) -> Any:
    """Our MPC of a problem."""
    if estimating:
        return kind(CAR, TUNING, profile="road", limits=LIMITS, scheduler=scheduler)
    paper = at.published_mpc(CAR)
    own = {"model": SingleTrackModel(CAR, PERIOD), "estimator": paper.estimator}
    return kind(CAR, TUNING, limits=LIMITS, preview=True, scheduler=scheduler, **own)


def recorded(estimating: bool, steps: int) -> list[tuple[Any, float, Any]]:
    """What our MPC is given on random drives in the profile `road`."""
    given: list[tuple[Any, float, Any]] = []
    for number in range(100):
        recorder = ours(estimating, Recording)
        at.simulate(at.DualTrack(CAR), recorder, random_drive(FIRST + number), profile="road", seed=number)
        given += recorder.given
        if len(given) >= steps:
            break
    rng = np.random.default_rng(0)  # a measured speed is another one at every step: nothing formed can be kept
    return [(state, speed * (1.0 + 1e-4 * rng.normal()), reference) for state, speed, reference in given[:steps]]


def exact_move(posed: Any) -> float:
    """The first move of a QP in extended precision: DAQP's active set, its equations refined, their signs checked.

    posed: E, K, and the bounds of moves and angles. NaN where the active set is not proved.
    """
    import daqp

    E, K, low, high = (np.array(each) for each in posed)
    rows = np.vstack([np.eye(MOVES), SUMS])
    sense = np.zeros(2 * MOVES, dtype=np.int32)
    x, _, _, info = daqp.solve(E, K, SUMS, high, low, sense, primal_tol=1e-12, dual_tol=1e-14)
    lam = np.asarray(info["lam"])
    active = np.abs(lam) > 1e-12
    N, bound = rows[active], np.where(lam > 0.0, high, low)[active]
    size = len(bound)
    system = np.block([[E, N.T], [N, np.zeros((size, size))]])
    right = np.concatenate([-K, bound]).astype(np.longdouble)
    z = np.concatenate([x, lam[active]]).astype(np.longdouble)
    for _ in range(5):
        z = z + np.linalg.solve(system, (right - system.astype(np.longdouble) @ z).astype(float))
    x = z[:MOVES]
    inside = (rows @ x <= high + 1e-12).all() and (rows @ x >= low - 1e-12).all()
    signs = (z[MOVES:] * np.where(lam[active] > 0.0, 1.0, -1.0) >= -1e-12).all()
    return float(x[0]) if inside and signs else float("nan")


class Contender(NamedTuple):
    """What is timed."""

    name: str
    begin: Callable[[], Callable[..., Any]]
    """back to before the first step; the step"""
    off: float
    """rad, of the first move from that of the exact solution"""
    steps: int
    """that it is given"""


def from_python(controller: Any, *more: Any) -> Callable[[], Callable[..., Any]]:
    """`Contender.begin` of a controller's own `step`; more: what it is given besides."""

    def begin() -> Callable[..., Any]:
        controller.reset()
        return (lambda *given: controller.step(*given, *more)) if more else controller.step

    return begin


def compiled(mpc: Any) -> Callable[[], Callable[..., Any]]:
    """`Contender.begin` of our compiled step."""

    def begin() -> Callable[..., Any]:
        mpc.reset()
        measured, now, ahead, step = mpc._mpc.measured, mpc._now, mpc._reference, mpc._compiled_step()

        def kernel(state: Any, speed: float, reference: Any) -> None:
            measured[:4] = state
            now[:] = speed, ahead.take(reference)
            step()

        return kernel

    return begin


def off_of(controller: Any, given: list[Any], count: int = 400) -> float:
    """Largest difference (rad) of a first move from the exact one, over as many steps."""
    controller.reset()
    worst = 0.0
    for state, speed, reference in given[:count]:
        if isinstance(controller, at.MPC):
            qp = controller.problem(state, speed, reference)
            n = MOVES
            gamma = qp.gamma.reshape(n, 4)
            low, high = -np.concatenate([gamma[:, 1], gamma[:, 3]]), np.concatenate([gamma[:, 0], gamma[:, 2]])
            move = controller.step(state, speed, reference).move
            exact = exact_move((qp.E, qp.K, low, high))
        else:
            move = controller.step(state, speed, reference).move
            exact = exact_move(controller.posed)
        if np.isfinite(exact):
            worst = max(worst, abs(move - exact))
    return worst


def contenders(estimating: bool, given: list[Any]) -> tuple[list[Contender], list[str]]:
    """All contenders of a problem, and the names of what is not installed."""
    problem = Filtered if estimating else AsMeasured
    speeds = min(v for _, v, _ in given), max(v for _, v, _ in given)
    found: list[Contender] = []
    missing: list[str] = []
    n = len(given)
    off, look = off_of(ours(estimating), given), at.SchedulingVariables(15.0, 0.0, 0.8, 0.0)
    scheduled = from_python(ours(estimating, scheduler=rules(16)), look)
    found.append(Contender("ours, kernel", compiled(ours(estimating)), off, n))
    found.append(Contender("ours, MPC.step", from_python(ours(estimating)), off, n))
    found.append(Contender("ours, MPC.step, 16 rules", scheduled, float("nan"), n))
    for kind in SOLVERS:
        for tabulated in (False, True):
            if tabulated and not hasattr(kind, "warm"):
                continue
            try:
                peer = Peer(problem(), kind(), tabulated, speeds)
            except ImportError:
                missing.append(kind.name)
                break
            count = min(SLOW, n) if getattr(kind, "slow", False) else n
            found.append(Contender(peer.name, from_python(peer), off_of(peer, given[:count]), count))
    try:
        nonlinear = DoMpc(problem())
        found.append(Contender(nonlinear.name, from_python(nonlinear), float("nan"), min(SLOW, n)))
    except ImportError:
        missing.append(DoMpc.name)
    return found, missing


def times_of(step: Callable[..., Any], given: list[Any], empty: float) -> Any:
    """CPU microseconds of each step."""
    found, clock = np.empty(len(given)), time.thread_time_ns
    gc.collect()
    gc.disable()
    for i, (state, speed, reference) in enumerate(given):
        begun = clock()
        step(state, speed, reference)
        found[i] = clock() - begun - empty
    gc.enable()
    return found / 1e3


def table(estimating: bool, steps: int, rounds: int) -> dict[str, Any]:
    """A row for each contender."""
    given = recorded(estimating, steps)
    driven, missing = contenders(estimating, given)
    clock = time.thread_time_ns
    empty = float(np.median([-(clock() - clock()) for _ in range(2000)]))
    least: dict[str, Any] = {}
    for _ in range(rounds):
        for each in driven:
            times = times_of(each.begin(), given[: each.steps], empty)
            least[each.name] = np.minimum(least.get(each.name, np.inf), times)
    rows = []
    for each in driven:
        times = least[each.name]
        row = {"contender": each.name, "steps": each.steps}
        row |= {f"p{share:g}_us": round(float(np.percentile(times, share)), 2) for share in (50, 99, 99.9)}
        rows.append({**row, "max_us": round(float(times.max()), 2), "off_rad": each.off})
    own = {row["contender"]: row["p50_us"] for row in rows}
    best = {
        form: min(row["p50_us"] for row in rows if row["contender"].endswith(form)) for form in ("plain", "tabulated")
    }
    for row in rows:
        row["ratio"] = round(row["p50_us"] / own["ours, MPC.step"], 2)
    ratios = {f"best_{form}_over_ours": round(value / own["ours, MPC.step"], 2) for form, value in best.items()}
    return {"rows": rows, "missing": missing, **ratios, "limited": limited(estimating, given)}


def limited(estimating: bool, given: list[Any]) -> float:
    """Share of the steps at a limit."""
    mpc = ours(estimating)
    return round(float(np.mean([mpc.step(*each).at_limit > 0 for each in given])), 3)


def rules(count: int) -> Any:
    """A scheduler of four fuzzy systems with so many rules that always asks for the same horizons."""
    rng, names = np.random.default_rng(count), ("speed", "y_ref", "friction", "wind")
    domain = np.array([(3.0, 27.0), (-15.0, 15.0), (0.5, 0.9), (-30.0, 30.0)])
    width = domain[:, 1] - domain[:, 0]

    def system(value: float) -> Sugeno:
        centres = rng.uniform(domain[:, 0], domain[:, 1], (count, 4)).ravel()
        premises = np.column_stack((np.tile(0.18 * width, count), np.ones(4 * count), centres))
        consequents = np.zeros((count, 5))
        consequents[:, -1] = value
        owner, of_rule = np.tile(np.arange(4), count), np.arange(4 * count).reshape(count, 4)
        return Sugeno(owner, np.zeros(4 * count, bool), premises, of_rule, consequents, np.ones(count))

    values = dict(zip(("Np", "Nc", "Q", "R"), (HORIZON, MOVES, TUNING.Q, TUNING.R), strict=True))
    bounds = {**SEARCH, "R": (1.0, 1e5)}
    return Learned({name: system(float(value)) for name, value in values.items()}, names, domain, bounds)


# -- closed loops -----------------------------------------------------------------------------------------------------
def loops(drives: int, threads: int) -> dict[str, Any]:
    """Closed loops of a random drive per CPU second, and per second on all threads: ours and the fastest peer's."""
    scenarios = [random_drive(FIRST + i) for i in range(drives)]
    plant, peers = at.DualTrack(CAR), {}
    at.rollout_batch(plant, ours(True), scenarios[:1], profile="road")
    begun, cpu = time.perf_counter(), time.process_time()
    at.rollout_batch(plant, ours(True), scenarios, profile="road", seeds=np.arange(drives), threads=threads)
    wall, cpu = time.perf_counter() - begun, time.process_time() - cpu
    for kind, tabulated in ((Daqp, True), (Osqp, True), (Piqp, True), (Daqp, False)):
        try:
            peer = Peer(Filtered(), kind(), tabulated, (1.0, 35.0))
        except ImportError:
            continue
        used = []
        for i in range(3):
            before = time.process_time()
            at.simulate(plant, peer, scenarios[i], profile="road", seed=i)
            used.append(time.process_time() - before)
        peers[peer.name] = round(1.0 / min(used), 3)
    rate, fastest = drives / cpu, max(peers.values())
    return {
        "seconds_a_drive": float(scenarios[0].duration), "ours_per_cpu_second": round(rate, 1),
        "ours_per_second": round(drives / wall, 1), "threads": threads, "peers_per_cpu_second": peers,
        "ratio_per_cpu_second": round(rate / fastest, 1),
    }  # fmt: skip


# -- what a step costs ------------------------------------------------------------------------------------------------
def flops(Np: int, Nc: int, n: int) -> int:
    """Operations of a step of the paper's MPC at a new speed: what its formulas need, no limit active.

    F and Phi from the model (2 n^2 + 4 n a period), E by its recursion, its factor, the free response, K, and the
    solution with the factor.
    """
    forming = Np * (2 * n * n + 4 * n) + 2 * Nc * (Np - Nc) + Nc * Nc + Nc**3 // 3
    return forming + 2 * n * Np + 2 * Np * Nc + 2 * Nc * Nc


def peak_gflops() -> float:
    """Of one core: the fastest of some products of 512 x 512 matrices, GFLOP/s of CPU time."""
    a, best = np.random.default_rng(0).normal(size=(512, 512)), np.inf
    for _ in range(20):
        begun = time.thread_time_ns()
        a @ a
        best = min(best, time.thread_time_ns() - begun)
    return 2.0 * 512**3 / best


def cost(steps: int, rounds: int) -> dict[str, Any]:
    """Median CPU microseconds of a compiled step over Np, Nc and rules, beside the floor of its operations."""
    given, peak, rows = recorded(False, steps), peak_gflops(), []
    paper = at.published_mpc(CAR)
    parts = {"model": SingleTrackModel(CAR, PERIOD), "estimator": paper.estimator}
    empty = float(np.median([-(time.thread_time_ns() - time.thread_time_ns()) for _ in range(2000)]))
    for Np, Nc in ((10, 5), (30, 1), (30, 5), (30, 10), (30, 18), (60, 10), (60, 18)):
        mpc = at.MPC(CAR, Tuning(Np, Nc, 1.0, TUNING.R), limits=LIMITS, preview=True, **parts)
        begin, found = compiled(mpc), np.inf
        for _ in range(rounds):
            found = np.minimum(found, times_of(begin(), given, empty))
        us, operations = float(np.median(found)), flops(Np, Nc, 4)
        floor = operations / peak / 1e3
        kept = 8 * (6 * Np + 3 * Nc * Nc + 8 * Nc)
        rows.append({
            "Np": Np, "Nc": Nc, "p50_us": round(us, 2), "flop": operations, "floor_us": round(floor, 3),
            "times_floor": round(us / floor, 1), "bytes": kept,
        })  # fmt: skip
    scheduled = []
    for count in (4, 16, 64, 256):
        look, times = at.SchedulingVariables(15.0, 0.0, 0.8, 0.0), np.inf
        begin = from_python(ours(False, scheduler=rules(count)), look)
        for _ in range(rounds):
            times = np.minimum(times, times_of(begin(), given, empty))
        scheduled.append({"rules": count, "python_p50_us": round(float(np.median(times)), 2)})
    return {"peak_gflops": round(peak, 1), "rows": rows, "rules": scheduled, "threads": batches()}


def batches() -> list[dict[str, Any]]:
    """Control steps per second of a batch over threads, and per CPU second."""
    scenarios, found = [random_drive(FIRST + i) for i in range(64)], []
    for threads in sorted({1, 2, os.cpu_count() or 1}):
        begun, cpu = time.perf_counter(), time.process_time()
        run = at.rollout_batch(at.DualTrack(CAR), ours(True), scenarios, profile="road", threads=threads)
        wall, used = time.perf_counter() - begun, time.process_time() - cpu
        steps = int(run.steps.sum())
        found.append({
            "threads": threads, "steps_per_second": round(steps / wall), "steps_per_cpu_second": round(steps / used),
        })  # fmt: skip
    return found


def shown(title: str, found: dict[str, Any]) -> None:
    """Print a part as lines."""
    print(f"\n{title}")
    for key, value in found.items():
        if isinstance(value, list) and value and isinstance(value[0], dict):
            for row in value:
                print("  " + "  ".join(f"{name} {each:.3g}" if isinstance(each, float) else f"{name} {each}"
                                       for name, each in row.items()))  # fmt: skip
        else:
            print(f"  {key}: {value}")


def main() -> None:
    """Print every part that is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, default=600)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--drives", type=int, default=64)
    parser.add_argument("--only", default="step,estimator,loops,cost")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    logging.disable(logging.WARNING)
    parts: dict[str, Callable[[], dict[str, Any]]] = {
        "step": lambda: table(False, options.steps, options.rounds),
        "estimator": lambda: table(True, options.steps, options.rounds),
        "loops": lambda: loops(options.drives, os.cpu_count() or 1),
        "cost": lambda: cost(options.steps, options.rounds),
    }
    with one_blas_thread():
        found = {name: part() for name, part in parts.items() if name in options.only.split(",")}
    found["machine"] = _machine()
    if options.json:
        print(json.dumps(found))
        return
    for name, part in found.items():
        shown(name, part)


if __name__ == "__main__":
    main()
