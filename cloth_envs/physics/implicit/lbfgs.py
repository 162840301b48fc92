"""Secants of a limited-memory quasi-Newton method around a prefactored matrix."""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np
from _minicloth_kernels import Contact, Potential

ARMIJO = 1e-4
MAX_HALVINGS = 30
START = 1e-3  # of the residual that is enough, which a start may have to be the end


class Secants:
    """The inverse Hessian of L-BFGS in compact form (Byrd, Nocedal & Schnabel 1994, theorem 2.2).

    Holds the last ``window`` pairs of a step ``s`` and the change ``y`` of the gradient over it. What is
    held (handles, contact) is taken out by ``confine`` before and after the prefactored solve, so that
    directions stay in the free subspace whatever it was when the pairs were stored.
    """

    def __init__(self, window: int, size: int) -> None:
        self._s, self._y = np.empty((window, size)), np.empty((window, size))
        self._sy = np.empty((window, window))  # s_i . y_j
        self._order: list[int] = []  # rows in use, oldest first

    def clear(self) -> None:
        self._order = []

    def add(self, s: np.ndarray, y: np.ndarray) -> None:
        """Keep a pair, and forget the oldest where there is no room; a pair without curvature is left out."""
        if not s @ y > 1e-12 * np.sqrt((s @ s) * (y @ y)):
            return
        order, window = self._order, len(self._s)
        row = order.pop(0) if len(order) == window else len(order)
        order.append(row)
        used = len(order)
        self._s[row], self._y[row] = s, y
        self._sy[:used, row], self._sy[row, :used] = self._s[:used] @ y, self._y[:used] @ s

    def apply(
        self, g: np.ndarray, solve: Callable[[np.ndarray], np.ndarray], confine: Callable[[np.ndarray], None]
    ) -> np.ndarray:
        """``H g`` for ``g`` ``(size,)`` in the free subspace; ``solve`` is ``H_0``."""
        order = self._order
        s, y = self._s[: len(order)], self._y[: len(order)]
        upper = np.triu(self._sy[np.ix_(order, order)])
        first, second = np.empty(len(order)), np.empty(len(order))
        first[order] = np.linalg.solve(upper, (s @ g)[order])
        q = g - first @ y
        confine(q)
        out = solve(q)
        confine(out)
        second[order] = np.linalg.solve(upper.T, (np.diag(self._sy)[: len(order)] * first - y @ out)[order])
        out += second @ s
        confine(out)
        return out


class Minimum(NamedTuple):
    """Where ``minimise`` ended."""

    x: np.ndarray
    gradient: np.ndarray  # of the potential alone [N]
    free_gradient: np.ndarray  # with friction, without what is held [N]
    iterations: int
    residual: float  # largest free gradient over a vertex's mass [m/s^2]


def minimise(
    potential: Potential,
    contact: Contact,
    solve: Callable[[np.ndarray], np.ndarray],
    x: np.ndarray,
    mass: np.ndarray,
    *,
    enough: float,
    max_iterations: int,
    secants: Secants,
) -> Minimum:
    """Descend from ``x`` ``(3 n,)`` until the residual is at most ``enough`` [m/s^2].

    A start is left even if its own is: cloth that went on as it moves would keep that residual from step to step.
    Every iterate lies outside the bodies. In an iteration the loads of the contacts, hence the largest friction,
    are those of its start (a Tresca problem); at the end they are the contacts' own (Coulomb's law). A step is
    accepted when it lowers the potential with friction by 1e-4 of the slope, or, where rounding hides the change of
    the potential, when the slope along the step has not grown (Hager & Zhang 2005).
    """
    contact.project(x, x)
    gradient, free = np.empty_like(x), np.empty_like(x)
    energy = potential.evaluate(x, gradient)
    for iterations in range(max_iterations + 1):
        residual = contact.classify(x, gradient, mass, free)
        if residual <= (enough if iterations else START * enough) or iterations == max_iterations:
            break
        confine = partial(contact.confine, x)
        with_friction = gradient.copy()
        value = energy + contact.friction(x, with_friction)
        step = secants.apply(free, solve, confine)
        if free @ step <= 0:
            secants.clear()
            step = secants.apply(free, solve, confine)
        length = 1.0
        for _ in range(MAX_HALVINGS):
            trial = x - length * step
            contact.project(x, trial)
            moved = trial - x
            new_gradient = np.empty_like(x)
            new_energy = potential.evaluate(trial, new_gradient)
            new_friction = new_gradient.copy()
            new_value = new_energy + contact.friction(trial, new_friction)
            slope = free @ moved
            if new_value - value <= ARMIJO * slope:
                break
            if abs(new_value - value) <= 1e-13 * abs(value) and abs(new_friction @ moved) <= -slope:
                break
            length /= 2
        secants.add(moved, new_friction - with_friction)
        x, gradient, energy = trial, new_gradient, new_energy
    return Minimum(x, gradient, free, iterations, residual)
