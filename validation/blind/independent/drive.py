"""How a force drives one channel, and how strong its effects are made."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from validation.blind.independent.draws import Floats, rms
from validation.blind.independent.effects import Effect, Stage
from validation.blind.independent.session import Clock

Chain = Sequence[tuple[Effect, float]]
"""Effects with their amplitudes; amplitude 0 is no effect."""
Wanted = Sequence[tuple[str, float]]
"""(effect, strength) pairs; strength is RMS of what k alone leaves over, in units of the noise."""


@dataclass(frozen=True)
class Channel:
    """Response and logged force of the frames, without noise, and the effects in them."""

    response: Floats
    force_n: Floats
    chain: Chain
    reached: Mapping[str, float]


@dataclass(frozen=True)
class Drive:
    """What drives a channel: a force on the fine steps, a compliance; and the response's noise."""

    clock: Clock
    force_n: Floats
    compliance: float
    noise: float

    def channel(self, wanted: Wanted, draw_effect: Callable[[str], Effect]) -> Channel:
        """The channel with each effect as strong, alone, as is asked for."""
        chain, reached = [], {}
        for name, strength in wanted:
            effect = draw_effect(name)
            amplitude, reached[name] = self._amplitude_for(effect, strength)
            chain.append((effect, amplitude))
        response, force_n = self._frames(chain)
        return Channel(response, force_n, chain, reached)

    def _frames(self, chain: Chain) -> tuple[Floats, Floats]:
        """Response and logged force of the frames."""
        response = self.force_n
        logged_n = self.force_n
        for stage in Stage:
            if stage is Stage.GAIN:
                response = self.compliance * response
            for effect, amplitude in chain:
                if effect.stage is not stage or amplitude == 0:
                    continue
                if stage is Stage.GAUGE:
                    logged_n = effect.act(logged_n, amplitude)
                else:
                    response = effect.act(response, amplitude)
        return response[self.clock.sampled], logged_n[self.clock.sampled]

    def _strength(self, effect: Effect, amplitude: float) -> float:
        """RMS of what the best compliance leaves over, in units of the noise."""
        response, force_n = self._frames([(effect, amplitude)])
        fitted = force_n * ((force_n * response).sum() / (force_n * force_n).sum())
        return rms(response - fitted) / self.noise

    def _amplitude_for(self, effect: Effect, strength: float) -> tuple[float, float]:
        """The amplitude that gives a strength, or the largest that makes sense; what it gives."""
        if strength <= 0:
            return 0.0, 0.0
        low, high = 0.0, effect.largest * 1e-3
        while self._strength(effect, high) < strength:
            if high >= effect.largest:
                return high, self._strength(effect, high)
            low, high = high, min(high * 1.8, effect.largest)
        for _ in range(60):
            middle = 0.5 * (low + high)
            reached = self._strength(effect, middle)
            if abs(reached / strength - 1) < 1e-3:
                return middle, reached
            low, high = (middle, high) if reached < strength else (low, middle)
        return high, self._strength(effect, high)
