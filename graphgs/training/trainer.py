"""One run's state, and its single step."""

import dataclasses

import numpy as np
import torch
from torch import Tensor

from graphgs.graph import CameraGraph
from graphgs.graph.sampler import ViewSampler
from graphgs.losses import photometric_loss
from graphgs.points import DenseCloud
from graphgs.rendering import IntersectionOverflow, RenderOutput, rasterize
from graphgs.rendering.splats import Splats
from graphgs.scene.views import Views
from graphgs.training.config import TrainConfig
from graphgs.training.consistency import ConsistencyTerm
from graphgs.training.exposure import Exposure
from graphgs.training.floaters import FloaterFinder
from graphgs.training.images import TrainingImages
from graphgs.training.loss_sampling import LossSampler
from graphgs.training.near import scene_near
from graphgs.training.parameters import Parameters
from graphgs.training.pose_refinement import PoseRefinement
from graphgs.training.regularisation import Regularisation
from graphgs.training.robust import fitting_pixels
from graphgs.training.schedule import Schedule
from graphgs.training.sky import scene_middle
from graphgs.training.strategy import Strategy, make_strategy
from graphgs.training.surface_depth import SurfaceDepth
from graphgs.training.warm_up import reduce_camera, reduce_photo, reduction_of

RECOVERY_RATE = 0.5  # learning rates after a roll-back
LEAST_LOG_SCALE = -87.0  # the standard deviation is then the smallest normal float32; below, exp becomes 0


class Trainer:
    """Gaussians, optimiser, strategy and position in the schedule. A step depends on these, the seed and the step
    number alone: not on time, on threads, or on where the run was interrupted."""

    def __init__(
        self,
        config: TrainConfig,
        views: Views,
        graph: CameraGraph,
        initial: Splats,
        *,
        extent: float,  # scene extent, world units
        near_depths: np.ndarray | None = None,  # [N] camera z at which each training view begins; None: not known
        device: str,
        seed: int,
        surfaces: DenseCloud | None = None,
    ):
        self.config, self.views, self.graph, self.device = config, views, graph, device
        self.schedule = Schedule(config)
        self.done = 0  # executed steps
        self.recoveries = 0
        self.between_steps = True  # False while a step is half applied
        self.parameters = Parameters.from_splats(initial)
        middle = None
        if config.sky != "none":
            middle = torch.as_tensor(scene_middle(views), dtype=torch.float32, device=device)
        self.strategy: Strategy = make_strategy(
            config, self.schedule, extent=extent, seed=seed, count=len(initial), device=device, middle=middle
        )
        self._extent = extent
        self._near_depths = np.full(len(views.names), np.nan) if near_depths is None else near_depths
        self._near = scene_near(self._near_depths, config.near_fraction)
        self._regularisation = Regularisation(config, extent=extent)
        self._Ks = torch.as_tensor(views.Ks, dtype=torch.float32, device=device)
        self._viewmats = torch.as_tensor(views.viewmats, dtype=torch.float32, device=device)
        self._exposure = None if config.exposure == "none" else Exposure(config, views.is_test, device=device)
        self._poses = None
        if config.refine_poses:
            self._poses = PoseRefinement(config, views.viewmats, views.is_test, extent=extent, device=device)
        index = {name: k for k, name in enumerate(views.names)}
        self._view_of_node = np.array([index.get(name, -1) for name in graph.names])
        self._sampler = _sampler(config, graph, seed=seed, device=device)
        self._images = TrainingImages(
            views, budget_bytes=config.image_cache_bytes, view_of_step=self.view_of_step, device=device
        )
        self._consistency = (
            None if config.consistency == "none" else ConsistencyTerm(config, views, graph, device=device, seed=seed)
        )

        self._surface_depth = None
        if config.lambda_depth > 0.0 and surfaces is not None and len(surfaces):
            self._surface_depth = SurfaceDepth(config, views, surfaces, device=device)

    def view_of_step(self, step: int) -> int:
        """The training view of an executed step."""
        view = int(self._view_of_node[self._sampler.view(step)])
        if view < 0 or self.views.is_test[view]:
            raise ValueError(f"graph: step {step} drew a view that is not a training view")
        return view

    def step(self) -> Tensor:
        """Execute one step; the loss, detached."""
        self.between_steps = False
        step = self.done
        try:
            loss, photometric, out = self._gradients(step)
        except IntersectionOverflow:  # a GPU learns late that a view met more tiles than any before; now there is room
            self.parameters.clear_gradients()
            loss, photometric, out = self._gradients(step)
        self.strategy.after_backward(step, out)
        self.parameters.step(step, self._rates(step), rows=self._updated_rows(out))
        if isinstance(self._sampler, LossSampler):
            self._sampler.note(self._sampler.view(step), step, photometric)
        for fit in self._fits.values():
            fit.step(self.view_of_step(step), step, self._caution)
        self.strategy.after_step(step, self.parameters)
        if self.schedule.removes_floaters_after(step):
            self._remove_floaters(step)
        self.done += 1
        self.between_steps = True
        return loss

    def _gradients(self, step: int) -> tuple[Tensor, Tensor, RenderOutput]:
        """Render, compare, differentiate: the loss and its photometric part, detached, and the render behind them."""
        view, photo, mask = self._images.of_step(step)
        factor = reduction_of(*(int(side) for side in self.views.sizes[view]), self.schedule.reduction(step))
        photo, mask = reduce_photo(photo, mask, factor)
        degree = self.schedule.sh_degree(step)
        gaussians, absgrad = self._gaussians(), self.strategy.wants_absgrad(step)
        viewmat = self._viewmat(view, fitted_in=step)
        out = self._render(view, gaussians, degree, viewmat, factor=factor, absgrad=absgrad)
        colors = out.colors if self._exposure is None else self._exposure.apply(view, out.colors)
        if self.schedule.leaves_out_misfits(step):
            mask = fitting_pixels(colors, photo, mask, share=self.config.robust_share)
        photometric = photometric_loss(colors, photo, mask, ssim_weight=self.config.ssim_weight)
        loss = photometric
        if self._exposure is not None:
            loss = loss + self._exposure.penalty()
        if self._consistency is not None and self.schedule.has_consistency(step):
            detached = [tensor.detach() for tensor in gaussians]
            extra = self._consistency.loss(
                view,
                step,
                out,
                mask,
                viewmats=self.viewmats,
                expose=(lambda j, colors: colors) if self._exposure is None else self._exposure.applied_fixed,
                render=lambda j: self._render(j, detached, degree, self._viewmat(j)),
                photo=self._images.of_view,
            )
            if extra is not None:
                loss = loss + self.config.lambda_consistency * extra
        if self._surface_depth is not None and factor == 1:
            extra = self._surface_depth.loss(view, out)
            if extra is not None:
                loss = loss + self._surface_depth.weight(step) * extra
        if (penalty := self._regularisation.loss(*gaussians[2:4])) is not None:
            loss = loss + penalty
        self.strategy.before_backward(step, out)
        loss.backward()
        return loss.detach(), photometric.detach(), out

    def splats(self) -> Splats:
        """The Gaussians as they are, detached."""
        return dataclasses.replace(self.parameters.splats(self.config.sh_degree), near=self._near)

    @property
    def viewmats(self) -> np.ndarray:
        """[N, 4, 4] float64 world-to-camera: of training views as refined so far, of held-out ones as given."""
        return self.views.viewmats if self._poses is None else self._poses.viewmats

    def fits(self) -> tuple[np.ndarray | None, np.ndarray | None]:
        """Refined viewmats [N, 4, 4] and exposures [N, 3, 4] of all views, each None where it is not fitted."""
        viewmats = None if self._poses is None else self._poses.viewmats.copy()
        return viewmats, None if self._exposure is None else self._exposure.transforms()

    @property
    def is_sound(self) -> bool:
        """Whether all that was learned, and the cameras it was learned with, are finite, and every Gaussian can be
        drawn. Kernels skip what a pose or a Gaussian that is not finite would draw: the loss alone does not tell."""
        cameras = self._viewmats.sum() + self._Ks.sum()
        finite = self.parameters.is_finite and all(fit.is_finite for fit in self._fits.values())
        return finite and bool(torch.isfinite(cameras)) and _have_extent(self.parameters)

    def state(self) -> dict[str, Tensor]:
        nested = {f"{part}.{k}": v for part, owner in self._parts.items() for k, v in owner.state().items()}
        return self.parameters.state() | nested

    def restore(self, done: int, state: dict[str, Tensor]) -> None:
        """Go on from `done` executed steps."""
        self.done = done
        self.parameters = Parameters.from_state(state, self.device)
        for part, owner in self._parts.items():
            owner.load_state({k.removeprefix(f"{part}."): v for k, v in state.items() if k.startswith(f"{part}.")})
        self.between_steps = True

    def close(self) -> None:
        self._images.close()

    @property
    def _fits(self) -> dict[str, Exposure | PoseRefinement]:
        """What is fitted to every training view."""
        return {name: fit for name, fit in (("exposure", self._exposure), ("poses", self._poses)) if fit is not None}

    @property
    def _parts(self) -> dict[str, Strategy | Exposure | PoseRefinement | LossSampler]:
        """What has a state of its own in a checkpoint."""
        sampler = {"sampler": self._sampler} if isinstance(self._sampler, LossSampler) else {}
        return {"strategy": self.strategy, **self._fits, **sampler}

    def _updated_rows(self, out: RenderOutput) -> Tensor | None:
        """[M] int64: the Gaussians that the step's view saw, if the rest stays; None is all."""
        return torch.nonzero(out.radii[0].amin(dim=-1) > 0)[:, 0] if self.config.sparse_adam else None

    @property
    def _caution(self) -> float:
        return RECOVERY_RATE**self.recoveries

    def _gaussians(self) -> tuple[Tensor, ...]:
        values = self.parameters.values
        return (
            values["means"],
            values["quats"],
            torch.exp(values["log_scales"]),
            torch.sigmoid(values["logit_opacities"]),
            values["sh_coeffs"],
        )

    def _render(
        self,
        view: int,
        gaussians: tuple[Tensor, ...] | list[Tensor],
        degree: int | None,  # None: the Gaussians have colours
        viewmat: Tensor,  # [1, 4, 4]
        *,
        factor: int = 1,  # of reduction
        absgrad: bool = False,
        median_depth: bool = False,
    ) -> RenderOutput:
        sides = (int(side) for side in self.views.sizes[view])
        return rasterize(
            *gaussians,
            viewmat,
            *reduce_camera(self._Ks[view : view + 1], *sides, factor),
            sh_degree=degree,
            near=self._near,
            median_depth=median_depth,
            absgrad=absgrad,
            validate=False,  # the run looks at the losses, and rolls back
        )

    @torch.no_grad()
    def _remove_floaters(self, step: int) -> None:
        config, parameters = self.config, self.parameters
        if not (config.prune_near or config.prune_unconfirmed):
            return
        views = dataclasses.replace(self.views, viewmats=self.viewmats)
        finder = FloaterFinder(views, self.graph, config.near_fraction * self._near_depths)
        means, *rest = (tensor.detach() for tensor in self._gaussians()[:4])
        floaters = torch.zeros(len(parameters), dtype=torch.bool, device=self.device)
        if config.prune_near:
            floaters |= finder.too_near(means)
        if config.prune_unconfirmed:
            floaters |= finder.unconfirmed(
                means,
                lambda view, colors: self._render(
                    view, (means, *rest, colors), None, self._viewmat(view), median_depth=True
                ),
            )
        kept = torch.nonzero(~floaters)[:, 0]
        if 0 < len(kept) < len(floaters):
            parameters.keep(kept)
            self.strategy.keep_rows(kept)

    def _viewmat(self, view: int, *, fitted_in: int | None = None) -> Tensor:
        """[1, 4, 4] as it is now; with a gradient to the pose, if the step fits one."""
        if self._poses is None:
            return self._viewmats[view : view + 1]
        if fitted_in is not None and self._poses.moves(fitted_in):
            return self._poses.viewmat(view)
        return torch.as_tensor(self.viewmats[view : view + 1], dtype=torch.float32, device=self.device)

    def _rates(self, step: int) -> dict[str, float]:
        return {name: self._caution * rate for name, rate in self.schedule.rates(step, extent=self._extent).items()}


def _sampler(config: TrainConfig, graph: CameraGraph, *, seed: int, device: str) -> ViewSampler | LossSampler:
    if config.sampling == "loss":
        return LossSampler(graph, seed=seed, device=device)
    return ViewSampler(graph, seed=seed, mode=config.sampling, measure=config.importance)


def _have_extent(parameters: Parameters) -> bool:
    """Whether no Gaussian has a standard deviation of 0 or the quaternion 0, which stands for no rotation."""
    quats, log_scales = (parameters.values[name].detach() for name in ("quats", "log_scales"))
    return bool((quats.abs().amax(dim=-1) > 0.0).all() & (log_scales > LEAST_LOG_SCALE).all())
