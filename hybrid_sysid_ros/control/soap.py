"""SOAP: Adam in the eigenbasis of Shampoo's preconditioner.

Source: Vyas et al. (2025), SOAP: improving and stabilizing Shampoo using Adam, ICLR, algorithm 3. On small dense
networks it reaches in a few epochs what Adam does not in many, for a few small matrix products more in each step.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import torch

SHIFT = 1e-12
"""Added to the diagonal before the first eigenvectors are sought: the gradients of one batch may be of lower rank."""


@dataclass(eq=False)
class Moments:
    """Of one parameter G (m, n) or (m,): the mean of its gradient, the mean of its square in the eigenbasis, and for
    matrices the means of G G' and G' G with their eigenvectors.
    """

    mean: torch.Tensor
    square: torch.Tensor
    covariances: list[torch.Tensor]
    bases: list[torch.Tensor]

    @classmethod
    def of(cls, parameter: torch.Tensor) -> Moments:
        """None yet; vectors have no basis but their own."""
        sizes = parameter.shape if parameter.dim() == 2 else ()
        return cls(
            mean=torch.zeros_like(parameter),
            square=torch.zeros_like(parameter),
            covariances=[parameter.new_zeros(size, size) for size in sizes],
            bases=[torch.eye(size, dtype=parameter.dtype) for size in sizes],
        )

    def turned(self, values: torch.Tensor) -> torch.Tensor:
        """In the eigenbasis."""
        return self.bases[0].T @ values @ self.bases[1] if self.bases else values

    def turned_back(self, values: torch.Tensor) -> torch.Tensor:
        """From the eigenbasis."""
        return self.bases[0] @ values @ self.bases[1].T if self.bases else values

    def find_bases(self) -> None:
        """The eigenvectors as they are now."""
        self.bases = [
            torch.linalg.eigh(each + SHIFT * torch.eye(len(each), dtype=each.dtype))[1] for each in self.covariances
        ]

    def follow_bases(self) -> None:
        """One step of orthogonal iteration, the largest eigenvalue first."""
        for side, (covariance, basis) in enumerate(zip(self.covariances, self.bases, strict=True)):
            order = torch.argsort(torch.sum(basis * (covariance @ basis), dim=0), descending=True)
            self.square = self.square.index_select(side, order)
            self.bases[side] = torch.linalg.qr(covariance @ basis[:, order])[0]


class Soap:
    """Steps on parameters (matrices and vectors) that have gradients.

    rate: of learning, may be set between steps. decays: of the means of the gradient and of its squares. every: steps
    between two looks at the eigenvectors.
    """

    def __init__(
        self,
        parameters: Iterable[torch.nn.Parameter],
        *,
        rate: float,
        decays: tuple[float, float] = (0.95, 0.95),
        every: int = 10,
        least: float = 1e-8,
    ) -> None:
        """least: added to the root of the mean square."""
        self.rate = rate
        self._parameters = list(parameters)
        self._moments = [Moments.of(parameter.detach()) for parameter in self._parameters]
        self._decays = decays
        self._every = every
        self._least = least
        self._steps = 0

    def zero_grad(self) -> None:
        """Forget the gradients."""
        for parameter in self._parameters:
            parameter.grad = None

    @torch.no_grad()
    def step(self) -> None:
        """One step down the gradients; the first only finds the eigenvectors."""
        first, second = self._decays
        for parameter, moments in zip(self._parameters, self._moments, strict=True):
            gradient = parameter.grad
            if gradient is None:
                continue
            products = (gradient @ gradient.T, gradient.T @ gradient) if moments.bases else ()
            for covariance, product in zip(moments.covariances, products, strict=True):
                covariance.lerp_(product, 1.0 - second)
            if self._steps == 0:
                moments.find_bases()
                continue
            moments.mean.lerp_(gradient, 1.0 - first)
            turned = moments.turned(gradient)
            moments.square.mul_(second).addcmul_(turned, turned, value=1.0 - second)
            size = self.rate * (1.0 - second**self._steps) ** 0.5 / (1.0 - first**self._steps)
            direction = moments.turned(moments.mean) / (moments.square.sqrt() + self._least)
            parameter.add_(moments.turned_back(direction), alpha=-size)
            if self._steps % self._every == 0:
                moments.follow_bases()
        self._steps += 1
