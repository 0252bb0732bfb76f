"""Adam's step on the unknowns: finite, scaled, inside the legal ranges."""

from __future__ import annotations

import math

import drjit as dr
import mitsuba as mi
import numpy as np

from ..config.schema import OptimizerConfig
from ..filters import Filter, Layout, Nothing, OnUnknown, Step
from ..runtime.memory import parts
from ..runtime.schedule import factor
from ..samplers.sampler import Moments
from ..unknowns.parameters import as_numpy, flat, own, unflat
from ..unknowns.unknowns import Unknown, Unknowns

# Of a gradient's entry in units of ``Stepper.scale``: the square of a larger one is infinite, and a
# second moment that was infinite once holds its entry still for good.
FEW = 16  # numbers of an unknown at most, of which a run tells where it ends
_LARGEST = 1e18
# Times the largest root mean square of an unknown's entries so far, which divides all of them:
# larger entries are cut to it. Derivatives by the place of a surface that is seen nearly edge on
# have no finite variance (the hit moves by 1 / cos, and 1 / cos² has no mean over the pixels of
# something round): one such path, early in a run, would slow every vertex for hundreds of steps.
_OUTLIER = 4.0
_NONE = Nothing()


class Adam:
    """Dr.Jit's Adam: entry by entry, or for the ``uniform`` keys by one number for all entries of
    an unknown (AdamUniform, Nicolet et al. 2021), whose entries all take part in every step."""

    def __init__(self, uniform: list[str], s: OptimizerConfig):
        betas = {"lr": s.lr, "beta_1": s.beta_1, "beta_2": s.beta_2}
        self._uniform = uniform
        self._alone = mi.ad.Adam(**betas, mask_updates=s.mask_updates)
        self._together = mi.ad.Adam(**betas, uniform=True)

    def of(self, key: str) -> mi.ad.Adam:
        """Dr.Jit's optimiser that holds ``key``."""
        return self._together if key in self._uniform else self._alone

    def __getitem__(self, key: str):
        return self.of(key)[key]

    def __setitem__(self, key: str, value) -> None:
        self.of(key)[key] = value

    @property
    def state(self) -> dict:
        """Of all keys. To be read only: ``of`` holds what can be set."""
        return {**self._alone.state, **self._together.state}

    def step(self, rates: dict[str, float]) -> None:
        """One step along the values' gradients, at each key's rate. What has no rate rests: its
        moments and its count of steps, by which they are corrected, stay. Not evaluated."""
        for adam in (self._alone, self._together):
            resting = {key: adam.state.pop(key) for key in adam.state.keys() - rates.keys()}
            adam.set_learning_rate({key: rates[key] for key in adam.state})
            adam.step(eval=False)
            adam.state.update(resting)


class Stepper:
    """Dr.Jit's Adam with what an inverse problem needs around it.

    - Gradient entries that are not finite, or whose squares are not, are counted (``nonfinite``, by
      key; ``touched`` counts these and all that are not zero) and replaced by zero before they
      reach a moment: one NaN would poison its entry for good.
    - Adam divides by √v̂ + ε with ε = 1e-8. A loss that is a mean over millions of pixels has
      gradients of that size, and ε would slow it silently. ``scale`` (per unknown, fixed for the
      run, from a rehearsal's root mean square, or where that met none from the first gradient)
      brings them to order 1; Adam is invariant to it but for ε.
    - What has neighbours may be filtered over them (``filter``).
    - Where one number divides all entries of an unknown, larger ones than ``_OUTLIER`` allows are
      cut.
    - After the step, values are clamped to their legal ranges.
    - An unknown whose stage it is not (``Unknown.moves``) is left out of the step.
    - Where unknowns pass through levels of resolution, what becomes finer begins with fresh
      moments; each level has a ``scale`` of its own (``scales``).
    """

    def __init__(self, unknowns: Unknowns, settings: OptimizerConfig, filter: Filter = _NONE):
        self.unknowns, self.settings, self.filter = unknowns, settings, filter
        self._filters: dict[tuple, OnUnknown] = {}
        self._falling = {}
        self.falls: dict[str, str] = {}  # the names of schedules, by key
        for u in unknowns:
            # What moves keeps the schedule that scenes found its rates with.
            paced = u.paced or u.kind.moves_geometry
            how = settings.falling(paced, u.schedule, u.final)
            self._falling[u.key] = factor(*how, settings.half)
            self.falls[u.key] = how[0]
        ends = [(falls(0.0, 0), falls(1.0, 0)) for falls in self._falling.values()]
        # Whether a larger budget would have changed the steps so far.
        self.paced = any(u.paced for u in unknowns) or any(a != b for a, b in ends)
        self.scales = [dict.fromkeys(unknowns.keys, 1.0) for _ in unknowns.switches]
        self.restart()

    def restart(self, level: int = 0, values: dict | None = None) -> None:
        """Fresh moments at a level, at the start unless ``values`` are given."""
        s = self.settings
        self.level = level
        if values is None:
            values = self.unknowns.starts(self.unknowns.shapes(level))
        self.adam = Adam([u.key for u in self.unknowns if u.kind.uniform], s)
        for key, value in values.items():
            self.adam[key] = value
        self.filtered = {key: self._filtering(key, values[key]) for key in self.unknowns.keys}
        self.nonfinite = {key: mi.UInt64(0) for key in values}
        self.touched = mi.UInt64(0)
        self.steps = 0  # at coarser levels too, unlike ``taken``
        # Of few numbers, since this process took them up, ``since`` so many steps: where they were,
        # and how far they could have gone by now, had all steps been along one way.
        self.begun: dict[str, np.ndarray] = {}
        self.since = 0
        self.reach = dict.fromkeys(values, 0.0)
        # The steps that each entry has taken part in, for the moments' bias corrections.
        self.visits = {key: dr.zeros(mi.Float, dr.width(flat(values[key]))) for key in values}
        # Opaque: as literals they would be compiled into the first step.
        dr.make_opaque(self.nonfinite, self.touched, self.visits)

    def _filtering(self, key: str, value) -> OnUnknown:
        """The filter on an unknown as coarse as ``value``, which has seen no step."""
        shape, unknown = tuple(np.shape(value)), self.unknowns[key]
        if (key, shape) not in self._filters:
            kind = unknown.kind
            passes = self.filter.layered and kind.levels > 1
            if kind.axes and not kind.uniform and not passes:
                layout = Layout.of(unknown, shape, bool(self.unknowns.moving))
                β = self.settings.beta_1, self.settings.beta_2
                made = self.filter.on(layout, β, self.settings.mask_updates)
            else:
                made = OnUnknown(Layout(shape, ()))
            self._filters[key, shape] = made
        made = self._filters[key, shape]
        made.forget()
        return made

    @property
    def scale(self) -> dict[str, float]:
        """Of the present level, by key; 1 for what has had no gradient yet."""
        return {key: each or 1.0 for key, each in self.scales[self.level].items()}

    def refine(self, level: int) -> None:
        """Go on at a finer level. What the images show stays, or nearly: where a level between two
        is met, and of a mesh, whose surface stays and whose normals are the finer one's.
        Evaluates."""
        shapes, self.level = self.unknowns.shapes(level), level
        for u in self.unknowns:
            coarse = dr.detach(self.adam[u.key])
            fine = u.kind.fine(coarse, shapes[u.key])
            if fine is not coarse:
                # Adam begins anew where a shape is new.
                self.adam[u.key] = dr.clip(fine, u.low, u.high)
                self.visits[u.key] = dr.zeros(mi.Float, dr.width(flat(fine)))
                self.filtered[u.key] = self._filtering(u.key, fine)
        dr.make_opaque(self.visits)
        dr.eval(self.adam.state)

    @property
    def values(self) -> dict:
        return {key: dr.detach(self.adam[key]) for key in self.unknowns.keys}

    @property
    def taken(self) -> int:
        """Steps since the start, or since the latest unknown became finer; of those whose stage has
        begun."""
        return min(filter(None, map(self._taken, self.unknowns.keys)), default=0)

    def _taken(self, key: str) -> int:
        """Steps of an unknown at the present level."""
        return int(self.adam.state[key][3][0][0])

    @property
    def untouched(self) -> list[str]:
        """Keys of the unknowns that have been stepped, and none of whose entries has had a gradient
        so far, finite or not."""
        # Of entries that never rest all steps are visits.
        masks = self.settings.mask_updates
        heard = {k: v if masks else flat(self.adam.state[k][3][2]) for k, v in self.visits.items()}
        lost = self.lost
        stepped = [key for key in heard if self._taken(key) and not lost[key]]
        return [key for key in stepped if not dr.any(heard[key] > 0)]

    @property
    def lost(self) -> dict[str, int]:
        """``nonfinite``. Waits."""
        return {key: int(count[0]) for key, count in self.nonfinite.items()}

    @property
    def filtering(self) -> bool:
        """Whether the filter does something to some unknown."""
        return not all(each.idle for each in self.filtered.values())

    def rate(self, spent: float) -> float:
        """The learning rate of unknowns without one of their own, or of the first where all have
        one, at this share of the budget, falling as the first of them says."""
        unrated = [u.key for u in self.unknowns if u.lr is None]
        first = self.unknowns[(unrated or self.unknowns.keys)[0]]
        return self._usual(first) * self._fallen(first.key, spent)

    def _rate(self, unknown: Unknown, spent: float) -> float:
        """0 while it rests."""
        return self._usual(unknown) * self._fallen(unknown.key, spent) * unknown.moves(spent)

    def _usual(self, unknown: Unknown) -> float:
        """Before it falls."""
        return (unknown.lr or self.settings.lr * unknown.speed) * self.settings.factor

    def _fallen(self, key: str, spent: float) -> float:
        """What an unknown's rate is multiplied with at present."""
        return self._falling[key](spent, self.steps)

    def step(self, gradients: dict, spent: float) -> None:
        """One Adam step along ``gradients`` (by key, any scale). Evaluates the new values."""
        gradients = self._directed(gradients, spent)
        if not self.begun:
            few = (u.key for u in self.unknowns if u.start.size <= FEW and not u.doubled)
            self.begun = {key: as_numpy(dr.detach(self.adam[key])) for key in few}
            self.since = self.steps
        for key, known in self.scales[self.level].items():
            unknown = self.unknowns[key]
            if not (known or unknown.unseen) and unknown.moves(spent):
                self._scale(key, gradients)
        scale = self.scale
        rates, gradient, touched = {}, {}, mi.UInt64(0)
        for unknown in self.unknowns:
            key = unknown.key
            if not unknown.moves(spent):
                continue
            rates[key] = self._rate(unknown, spent)
            self.reach[key] += rates[key]
            # Opaque, because the factor differs from run to run and would compile anew.
            entries = flat(gradients[key]) * dr.opaque(mi.Float, scale[key])
            finite = dr.abs(entries) < _LARGEST  # NaN is not
            self.nonfinite[key] += mi.UInt64(dr.count(~finite))
            touched += mi.UInt64(dr.count(~finite | (entries != 0)))
            clean = dr.select(finite, entries, 0)
            if unknown.kind.uniform:
                clean = own(mi.Float, self._cut(key, self._along(key, clean)))
            clean = self.filtered[key].gradient(clean, self._fallen(key, spent))
            took_part = (clean != 0) | (not self.settings.mask_updates)
            self.visits[key] += dr.select(took_part, mi.Float(1), 0)
            dr.set_grad(self.adam[key], unflat(gradients[key], clean))
            gradient[key] = clean
        self.touched += touched
        before = {key: dr.detach(self.adam[key]) for key in rates}
        self.adam.step(rates)
        for key, rate in rates.items():
            if self.filtered[key].moves:
                self._move(key, before[key], gradient[key], rate, self._fallen(key, spent))
        self.steps += 1
        for unknown in self.unknowns:
            self._legal(unknown)
        for each in self.unknowns.together:
            if {each.lens, each.size} <= before.keys():
                # By what the lens has kept of its step.
                ends = (dr.detach(self.adam[key]) for key in (each.lens, each.size))
                self.adam[each.size] = each.follow(before[each.lens], *ends)
                self._legal(self.unknowns[each.size])
        memory = [each.memory for each in self.filtered.values()]
        dr.eval(self.adam.state, self.nonfinite, self.touched, self.visits, memory)

    def _legal(self, unknown: Unknown) -> None:
        """Put the legal value next to an unknown's in its place. Traced."""
        value = dr.detach(self.adam[unknown.key])
        if np.isfinite(unknown.low) or np.isfinite(unknown.high):
            self.adam[unknown.key] = value = dr.clip(value, unknown.low, unknown.high)
        if (projected := unknown.kind.projected(value)) is not value:
            self.adam[unknown.key] = projected

    def _directed(self, gradients: dict, spent: float | None = None) -> dict:
        """Where steps go for these, at the share ``spent`` of the schedule, or where all move.
        Traced."""
        for each in self.unknowns.together:
            both = (self.unknowns[key] for key in (each.lens, each.size))
            if spent is None or all(unknown.moves(spent) for unknown in both):
                gradients = each.directed(gradients, self.adam)
        return {k: self.unknowns[k].kind.directed(g, self.adam[k]) for k, g in gradients.items()}

    def _move(self, key: str, before, gradient: mi.Float, rate: float, share: float) -> None:
        """Put what the filter makes of Adam's step in its place. Traced."""
        after, (_, first, second, _) = self.adam[key], self.adam.state[key][3]
        t, (β1, β2) = self._taken(key), (self.settings.beta_1, self.settings.beta_2)
        # On the host: Adam's count is a literal, which would compile a kernel for every step.
        corrected = dr.opaque(mi.Float, rate * math.sqrt(1 - β2**t) / (1 - β1**t))
        values = (flat(dr.detach(each)) for each in (before, after))
        step = Step(*values, gradient, flat(first), flat(second), corrected, share)
        self.adam[key] = unflat(before, self.filtered[key].moved(step))

    def _along(self, key: str, gradient) -> np.ndarray:
        """The entries that Adam averages of ``gradient``, unscaled, on the host: those of
        ``Kind.smoothed`` where the unknown has it, float64, which takes what is not finite for 0;
        else as they are."""
        entries, kind = np.array(flat(gradient)), self.unknowns[key].kind
        if not kind.uniform:
            return entries
        entries = entries.astype(np.float64)
        clean = np.where(np.isfinite(entries), entries, 0)
        return kind.smoothed(clean.reshape(tuple(self.adam[key].shape))).ravel()

    def _cut(self, key: str, entries: np.ndarray) -> np.ndarray:
        """``entries`` of ``_along``, scaled, none beyond ``_OUTLIER``; float32."""
        count, _, second, _ = self.adam.state[key][3]
        if steps := int(count[0]):
            largest = float(dr.max(second)[0]) / (1 - self.settings.beta_2**steps)
            most = _OUTLIER * math.sqrt(largest)
            if most > 0:
                entries = np.clip(entries, -most, most)
        return entries.astype(np.float32)

    def calibrate(self, gradients: list[dict], later: list[dict] = ()) -> None:
        """Fix ``scale`` as 1 / (root mean square of the non-zero finite entries), per unknown; of
        one that is no finer than at the level before, whose moments go on, as it was there.
        ``later``: estimates of later stages, for unknowns of which the first know nothing. 0 where
        these do not either: ``step`` fixes it."""
        shapes, gradients = self.unknowns.shapes, [self._directed(g) for g in gradients]
        scales = self.scales[self.level]
        for key in self.unknowns.keys:
            if self.level and shapes(self.level)[key] == shapes(self.level - 1)[key]:
                scales[key] = self.scales[self.level - 1][key]
                continue
            squares, count = self._squares(key, gradients)
            if not count:
                squares, count = self._squares(key, [self._directed(g) for g in later])
            scales[key] = 1 / math.sqrt(squares / count) if count else 0.0

    def _scale(self, key: str, gradients: dict) -> None:
        """Fix ``scale`` by the first of ``gradients`` that is not zero: all moments are until then.
        Waits."""
        entries = flat(gradients[key])
        if not dr.any(dr.isfinite(entries) & (entries != 0)):
            return
        squares, count = self._squares(key, [gradients])
        if not count:  # what is averaged may be 0 still
            return
        shapes = self.unknowns.shapes
        for level in range(self.level, len(self.scales)):  # where its moments go on
            if shapes(level)[key] == shapes(self.level)[key]:
                self.scales[level][key] = 1 / math.sqrt(squares / count)

    def _squares(self, key: str, gradients: list[dict]) -> tuple[float, int]:
        """Of entries that are finite and not zero, the sum of their squares, and how many."""
        squares, count = 0.0, 0
        for gradient in gradients:  # one by one: large grids side by side fill a memory
            every = self._along(key, gradient[key])
            for part in parts(every.size):
                entries = every[part].astype(np.float64)
                entries = entries[np.isfinite(entries) & (entries != 0)]
                squares, count = squares + float(np.sum(entries**2)), count + entries.size
        return squares, count

    def noise(self, gradients: dict, spent: float = 0.0) -> float:
        """How far the gradient lies from its running mean: PBDR Eq. (9) of one iteration t,

            1/N Σ_k (g_t,k^smoothed - g_t,k^unsmoothed)²,

        g^unsmoothed the estimate ``gradients``, g^smoothed Adam's first moment after the step,
        bias-corrected for the steps that each entry took part in (``mask_updates`` leaves entries
        out, for which Adam's own correction, by the number of all steps, would be wrong). The
        paper does not say what N is: here the entries k that the estimate touched at least the
        second time, as the first time the mean is the gradient itself. In the gradient's own
        unit, squared; NaN without such an entry. Of unknowns that move at the share ``spent`` of
        the schedule: others' means stand still. On the host.
        """
        total, count, gradients = 0.0, 0, self._directed(gradients, spent)
        scale = self.scale
        for key in (unknown.key for unknown in self.unknowns if unknown.moves(spent)):
            first = np.array(flat(self.adam.state[key][3][1]))
            every, visits = self._along(key, gradients[key]), np.array(self.visits[key])
            for part in parts(every.size):
                entries, steps = (each[part].astype(np.float64) for each in (every, visits))
                touched = np.isfinite(entries) & (entries != 0) & (steps > 1)
                weight = 1 - self.settings.beta_1 ** steps[touched]
                smoothed = first[part][touched].astype(np.float64) / weight
                total += float(np.sum((smoothed / scale[key] - entries[touched]) ** 2))
                count += int(touched.sum())
        return total / count if count else float("nan")

    def moments(self, spent: float) -> Moments:
        """Adam's moments after at least one step, as samplers read them. Evaluates."""
        first, second, noise = {}, {}, {}
        β = self.settings.beta_1
        sizes = {key: 1 / each for key, each in self.scales[self.level].items() if each}
        largest = max(sizes.values(), default=1.0)
        for key in self.unknowns.keys:
            t, m, v, _ = self.adam.state[key][3]
            m, v, steps = flat(m), flat(v), max(int(t[0]), 1)  # 0 before its stage
            unit = dr.opaque(mi.Float, sizes.get(key, largest) / largest)
            took_part = self.visits[key] * dr.opaque(mi.Float, 1 / steps)
            forgotten = dr.power(mi.Float(β), self.visits[key])
            part = 1 - forgotten
            first[key] = dr.select(part > 0, took_part * m / part, 0) * unit
            second[key] = v * dr.opaque(mi.Float, 1 / (1 - self.settings.beta_2**steps))
            second[key] *= dr.square(unit)
            # Σ of squared weights of a mean over n steps that forgets by β.
            share = (1 - β) / (1 + β) * (1 + forgotten) / part
            seen = 1 - dr.power(mi.Float(self.settings.beta_2), self.visits[key])
            touched = dr.select(seen > 0, v / seen, 0) * dr.square(unit)  # E[g²] where touched
            noise[key] = dr.select(part > 0, dr.square(took_part) * share * touched, 0)
        dr.eval(first, second, noise)
        rates = {u.key: self._rate(u, spent) for u in self.unknowns}
        return Moments(first, second, noise, rates, largest)

    def export(self) -> tuple[dict[str, np.ndarray], dict]:
        """Values and moments as arrays; step counts, scales and counters as JSON."""
        arrays, steps = {}, {}
        for key in self.unknowns.keys:
            count, first, second, _ = self.adam.state[key][3]
            arrays[f"value/{key}"] = as_numpy(self.adam[key])
            arrays[f"first/{key}"] = np.array(first)
            arrays[f"second/{key}"] = np.array(second)
            arrays[f"visits/{key}"] = np.array(self.visits[key])
            for name, memory in self.filtered[key].memory.items():
                arrays[f"filter/{name}/{key}"] = np.array(memory)
            steps[key] = int(count[0])
        counters = {"nonfinite": self.lost, "touched": int(self.touched[0])}
        levels = {"level": self.level, "scales": self.scales, "all_steps": self.steps}
        return arrays, {"steps": steps, **levels, **counters}

    def restore(self, arrays: dict[str, np.ndarray], state: dict) -> None:
        """Take over what ``export`` gave, to the last bit. KeyError where something is missing,
        InputError for what has another shape now."""
        values = {key: arrays[f"value/{key}"] for key in self.unknowns.keys}
        self.scales = [dict(scale) for scale in state["scales"]]
        self.restart(state["level"], self.unknowns.recorded(values))
        for key in self.unknowns.keys:
            value, promoted, rate, (count, first, second, most) = self.adam.state[key]
            moments = [type(first)(arrays[f"{name}/{key}"]) for name in ("first", "second")]
            steps = type(count)(state["steps"][key])
            self.adam.of(key).state[key] = value, promoted, rate, (steps, *moments, most)
            self.visits[key] = mi.Float(arrays[f"visits/{key}"])
            memory = self.filtered[key].memory
            for name in memory:
                memory[name] = own(mi.Float, arrays[f"filter/{name}/{key}"])
        self.steps = state["all_steps"]
        self.nonfinite = {key: mi.UInt64(state["nonfinite"][key]) for key in values}
        self.touched = mi.UInt64(state["touched"])
        dr.make_opaque(self.nonfinite, self.touched)
        dr.eval(self.adam.state)
