"""A video model that knows nothing of motion or cameras: a convolutional auto-encoder, and a GRU on its codes.

The two stages of the world models of Ha and Schmidhuber (2018), small: codes of single pictures first, then how the
inputs move them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from time import process_time

import numpy as np
import torch
from torch import Tensor, nn

from hybrid_sysid_ros.extensions.vision.camera.imager import Picture
from hybrid_sysid_ros.extensions.vision.reading.regression import Film
from hybrid_sysid_ros.support.arrays import Array

CODES, HIDDEN, KNOWN, STEPS = 16, 96, 5, 60  # KNOWN: pictures that a prediction begins with; STEPS: of a rollout
BATCH, RATE = 32, 2e-3
SPLIT = 0.5  # share of the training that the auto-encoder gets


class Codec(nn.Module):
    """Pictures to codes and back, about the mean picture."""

    def __init__(self, mean: Tensor) -> None:
        super().__init__()
        rows, columns = mean.shape
        self.mean: Tensor
        self.register_buffer("mean", mean)
        self.small = (32, -(-rows // 8), -(-columns // 8))
        flat = self.small[0] * self.small[1] * self.small[2]
        layers: list[nn.Module] = []
        for before, after in ((1, 8), (8, 16), (16, 32)):
            layers += [nn.Conv2d(before, after, 3, stride=2, padding=1), nn.SiLU()]
        self.encoder = nn.Sequential(*layers, nn.Flatten(), nn.Linear(flat, CODES))
        self.widen = nn.Sequential(nn.Linear(CODES, 128), nn.SiLU(), nn.Linear(128, flat), nn.SiLU())
        layers = []
        for before, after in ((32, 16), (16, 8), (8, 8)):
            layers += [nn.ConvTranspose2d(before, after, 4, stride=2, padding=1), nn.SiLU()]
        self.decoder = nn.Sequential(*layers, nn.Conv2d(8, 1, 3, padding=1))

    def encode(self, pictures: Tensor) -> Tensor:
        """Codes (pictures, CODES) of pictures (pictures, rows, columns), from 0 to 1."""
        return torch.as_tensor(self.encoder((pictures - self.mean)[:, None] * 4.0))

    def decode(self, codes: Tensor) -> Tensor:
        """And back."""
        rows, columns = self.mean.shape
        wide = self.decoder(self.widen(codes).reshape(-1, *self.small))
        return torch.as_tensor(self.mean + wide[:, 0, :rows, :columns])


class Motion(nn.Module):
    """Codes one picture on, by the inputs meanwhile."""

    def __init__(self, inputs: int) -> None:
        super().__init__()
        self.begin = nn.Sequential(nn.Linear(KNOWN * (CODES + inputs), HIDDEN), nn.Tanh())
        self.cell = nn.GRUCell(CODES + inputs, HIDDEN)
        self.step = nn.Linear(HIDDEN, CODES)

    def forward(self, codes: Tensor, inputs: Tensor) -> Tensor:
        """Codes (runs, steps, CODES) after KNOWN ones (runs, KNOWN, CODES), under inputs (runs, KNOWN + steps, m)."""
        hidden = self.begin(torch.cat([codes, inputs[:, :KNOWN]], dim=2).flatten(1))
        code, found = codes[:, -1], []
        for k in range(KNOWN - 1, inputs.shape[1] - 1):
            hidden = self.cell(torch.cat([code, inputs[:, k]], dim=1), hidden)
            code = code + self.step(hidden)
            found.append(code)
        return torch.stack(found, dim=1)


class BlackBox:
    """Trained on films (pictures, rows, columns) with the mean inputs (pictures, m) from each picture to the next."""

    def __init__(self, films: Sequence[Film], inputs: Sequence[Array], *, seconds: float, seed: int) -> None:
        """seconds: of processor time for all of the training."""
        torch.manual_seed(seed)
        torch.set_num_threads(1)
        self._random = np.random.default_rng(seed)
        joined = np.concatenate(inputs)
        self._centre, self._scale = joined.mean(axis=0), joined.std(axis=0)
        given = [self._scaled(each) for each in inputs]
        mean = torch.as_tensor(np.mean([film.mean(axis=0) for film in films], axis=0) / 255.0, dtype=torch.float32)
        self.codec, self.motion = Codec(mean), Motion(joined.shape[1])
        began = process_time()
        self._train_codec(films, began, SPLIT * seconds)
        with torch.no_grad():
            codes = [torch.cat([self.codec.encode(part) for part in _parts(film)]) for film in films]
        together = torch.cat(codes)
        self._middle, self._spread = together.mean(dim=0), together.std(dim=0) + 1e-3
        self._train_motion([(each - self._middle) / self._spread for each in codes], given, began, seconds)
        self.seconds = process_time() - began

    def predict(self, known: Film, inputs: Array) -> Film:
        """Pictures (steps, rows, columns) after the KNOWN last ones, under the inputs (KNOWN + steps, m) from the first
        of them on.
        """
        with torch.no_grad():
            codes = self.codec.encode(torch.as_tensor(known[-KNOWN:] / 255.0, dtype=torch.float32)) - self._middle
            following = self.motion((codes / self._spread)[None], self._scaled(inputs)[None])[0]
            shown = self.codec.decode(following * self._spread + self._middle)
        found: Picture = np.clip(np.round(255.0 * shown.numpy()), 0, 255).astype(np.uint8)
        return found

    def _scaled(self, inputs: Array) -> Tensor:
        return torch.as_tensor((inputs - self._centre) / self._scale, dtype=torch.float32)

    def _train_codec(self, films: Sequence[Film], began: float, until: float) -> None:
        optimiser = torch.optim.Adam(self.codec.parameters(), RATE)
        joined = np.concatenate(films)
        while (passed := process_time() - began) < until:
            optimiser.param_groups[0]["lr"] = RATE * max(1.0 - passed / until, 0.02)
            chosen = joined[self._random.integers(0, len(joined), BATCH)]
            pictures = torch.as_tensor(chosen / 255.0, dtype=torch.float32)
            loss = 1e3 * ((self.codec.decode(self.codec.encode(pictures)) - pictures) ** 2).mean()
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()

    def _train_motion(self, codes: Sequence[Tensor], inputs: Sequence[Tensor], began: float, until: float) -> None:
        optimiser = torch.optim.Adam(self.motion.parameters(), RATE)
        first = process_time() - began
        while (passed := process_time() - began) < until:
            share = (passed - first) / max(until - first, 1e-9)
            optimiser.param_groups[0]["lr"] = RATE * max(1.0 - share, 0.02)
            steps = min(STEPS, 5 + int(2 * STEPS * share))  # short rollouts first
            runs = [self._run(codes, inputs, steps) for _ in range(2 * BATCH)]
            seen, given = (torch.stack(list(part)) for part in zip(*runs, strict=True))
            loss = ((self.motion(seen[:, :KNOWN], given) - seen[:, KNOWN:]) ** 2).mean()
            optimiser.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(self.motion.parameters(), 1.0)
            optimiser.step()

    def _run(self, codes: Sequence[Tensor], inputs: Sequence[Tensor], steps: int) -> tuple[Tensor, Tensor]:
        """A part of a film."""
        film = int(self._random.integers(len(codes)))
        begin = int(self._random.integers(len(codes[film]) - KNOWN - steps))
        return codes[film][begin : begin + KNOWN + steps], inputs[film][begin : begin + KNOWN + steps]


def _parts(film: Film) -> Iterator[Tensor]:
    for k in range(0, len(film), 256):
        yield torch.as_tensor(film[k : k + 256] / 255.0, dtype=torch.float32)
