"""A method of nerfstudio in plain torch on the CPU: what nerfacto.py and tensorf.py share.

Everything is nerfstudio's own (method config, model, losses, optimisers, schedules, ray generator); this file
feeds it the photographs and holds the clock. nerfacto on an object scene uses the options nerfstudio's own
benchmark uses for synthetic scenes (``launch_train_blender.sh``); all else is the method as it stands.
"""

# pyright: reportMissingImports=false
import importlib.abc
import importlib.machinery
import importlib.metadata
import importlib.util
import os
import sys
import types
from collections.abc import Sequence
from copy import deepcopy
from typing import Any

os.environ.setdefault("OMP_WAIT_POLICY", "passive")

import numpy as np
from numpy.typing import NDArray
from protocol import measure, parser, scene_of
from scene import Scene, View

# Imported on the way to a method's config, of no use here: data readers, viewers, exporters, other methods.
UNUSED_HERE = (
    "appdirs",
    "av",
    "comet_ml",
    "fpsample",
    "gdown",
    "gsplat",
    "h5py",
    "imageio",
    "matplotlib",
    "mediapy",
    "msgspec",
    "newrawpy",
    "nuscenes",
    "open3d",
    "pathos",
    "plotly",
    "pymeshlab",
    "pyquaternion",
    "pytorch_msssim",
    "rawpy",
    "requests",
    "skimage",
    "sklearn",
    "splines",
    "torchvision",
    "trimesh",
    "viser",
    "wandb",
    "xatlas",
)


class _Absent(type):
    def __getattr__(cls, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return cls


class _Placeholder(metaclass=_Absent):
    """Stands for any class or function of a package that is imported on the way but of no use here."""

    def __init__(self, *_: object, **__: object) -> None: ...

    def __call__(self, *_: object, **__: object) -> "_Placeholder":
        return self


class _AbsentPackage(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Lets ``import torchvision`` and the like succeed where the package is not installed."""

    def __init__(self, names: Sequence[str]) -> None:
        self.names = {name for name in names if importlib.util.find_spec(name) is None}

    def find_spec(
        self,
        fullname: str,
        path: Sequence[str] | None,  # noqa: ARG002
        target: types.ModuleType | None = None,  # noqa: ARG002
    ) -> importlib.machinery.ModuleSpec | None:
        if fullname.partition(".")[0] not in self.names:
            return None
        return importlib.machinery.ModuleSpec(fullname, self, is_package=True)

    def exec_module(self, module: types.ModuleType) -> None:
        def attribute(name: str) -> Any:
            if name.startswith("__"):
                raise AttributeError(name)
            return _Placeholder

        module.__dict__["__getattr__"] = attribute


def _load_nerfstudio() -> None:
    absent = _AbsentPackage(UNUSED_HERE)
    sys.meta_path.append(absent)
    try:
        import torch
        import torchmetrics.image.lpip

        if absent.names & {"torchvision"}:  # LPIPS needs its networks; it is never computed here
            torchmetrics.image.lpip.LearnedPerceptualImagePatchSimilarity = torch.nn.Identity
        import nerfstudio.configs.method_configs  # noqa: F401
    except ImportError as error:
        raise SystemExit(
            f"nerfstudio cannot run under this Python: {error}; see benchmarks/peers/README.md"
        ) from error


class NerfstudioMethod:
    """The stock method of a name, on one scene; ``rays`` a step, None for the method's own batch."""

    def __init__(self, method: str, scene: Scene, rays: int | None, seed: int) -> None:
        import torch
        from nerfstudio.cameras.cameras import Cameras, CameraType
        from nerfstudio.configs.method_configs import method_configs
        from nerfstudio.data.scene_box import SceneBox
        from nerfstudio.engine.callbacks import TrainingCallbackAttributes, TrainingCallbackLocation
        from nerfstudio.engine.optimizers import Optimizers
        from nerfstudio.model_components.ray_generators import RayGenerator

        torch.manual_seed(seed)
        self.name = f"nerfstudio {method}"
        self.version = importlib.metadata.version("nerfstudio")
        config: Any = deepcopy(method_configs[method])
        model = config.pipeline.model
        if method == "nerfacto":
            model.implementation = "torch"
        if method == "nerfacto" and scene.is_object:
            model.disable_scene_contraction = True
            model.proposal_initial_sampler = "uniform"
            model.near_plane, model.far_plane = 2.0, 6.0
            model.camera_optimizer.mode = "off"
            model.use_average_appearance_embedding = False
            model.background_color = "white"
            model.distortion_loss_mult = 0.0
        self._rays = rays or config.pipeline.datamanager.train_num_rays_per_batch
        self._poses = _Poses(scene)
        box = SceneBox(aabb=torch.tensor([[-1.0] * 3, [1.0] * 3]) * (1.5 if scene.is_object else 1.0))
        self._model = model.setup(scene_box=box, num_train_data=len(scene.train), metadata={}, device="cpu")
        camera = scene.camera
        k1, k2, p1, p2 = camera.distortion

        def cameras(views: list[View]) -> Any:
            return Cameras(
                camera_to_worlds=torch.stack([self._poses.of(view) for view in views]),
                fx=camera.fl_x,
                fy=camera.fl_y,
                cx=camera.cx,
                cy=camera.cy,
                width=camera.width,
                height=camera.height,
                distortion_params=torch.tensor([k1, k2, 0.0, 0.0, p1, p2])
                if any(camera.distortion)
                else None,
                camera_type=CameraType.PERSPECTIVE,
            )

        self._cameras = cameras
        self._generator = RayGenerator(cameras(scene.train))
        self._photos = torch.from_numpy(np.stack([view.over_white for view in scene.train]))
        self._size = torch.tensor([len(scene.train), camera.height, camera.width])
        self._optimizers = Optimizers(config.optimizers, self._model.get_param_groups())
        pipeline: Any = types.SimpleNamespace(get_param_groups=self._model.get_param_groups)
        self._callbacks = self._model.get_training_callbacks(
            TrainingCallbackAttributes(
                optimizers=self._optimizers, grad_scaler=None, pipeline=pipeline, trainer=None
            )
        )
        self._before = TrainingCallbackLocation.BEFORE_TRAIN_ITERATION
        self._after = TrainingCallbackLocation.AFTER_TRAIN_ITERATION
        self._step = 0
        if method == "nerfacto":
            self._samples = model.num_nerf_samples_per_ray + sum(model.num_proposal_samples_per_ray)
        else:
            self._samples = model.num_samples + model.num_uniform_samples

    def step(self) -> tuple[int, int]:
        """One optimiser step; (rays, samples)."""
        import torch

        for callback in self._callbacks:
            callback.run_callback_at_location(self._step, location=self._before)
        index = (torch.rand(self._rays, 3) * self._size).long()
        self._model.train()
        outputs = self._model(self._generator(index))
        batch = {"image": self._photos[index[:, 0], index[:, 1], index[:, 2]], "indices": index}
        metrics = self._model.get_metrics_dict(outputs, batch)
        losses = self._model.get_loss_dict(outputs, batch, metrics)
        self._optimizers.zero_grad_all()
        torch.stack(list(losses.values())).sum().backward()
        self._optimizers.optimizer_step_all()
        self._optimizers.scheduler_step_all(self._step)
        for callback in self._callbacks:
            callback.run_callback_at_location(self._step, location=self._after)
        self._step += 1
        return self._rays, self._rays * self._samples

    def render(self, view: View) -> NDArray[np.float32]:
        """Colours (h, w, 3) of a test view."""
        import torch

        self._model.eval()
        with torch.no_grad():
            outputs = self._model.get_outputs_for_camera(self._cameras([view]))
        return outputs["rgb"].numpy()

    def notes(self) -> dict[str, object]:
        """What a reader must know to judge the figures."""
        return {
            "rays_per_step": self._rays,
            "samples": "of the field and of the proposals",
            "settings": "nerfstudio's own method config; nerfacto: implementation torch, objects with the "
            "options of its launch_train_blender.sh",
        }


class _Poses:
    """Photographs are turned upright, centred and scaled as nerfstudio's own reader does; objects are not."""

    def __init__(self, scene: Scene) -> None:
        import torch
        from nerfstudio.cameras.camera_utils import auto_orient_and_center_poses

        self._normalise, self._scale = torch.eye(4)[:3], 1.0
        if not scene.is_object:
            # As its dataparser: all frames, test views included; poses only, no pixel is seen.
            poses = torch.from_numpy(
                np.stack([view.T_world_camera for view in scene.train + scene.test])
            ).float()
            oriented, self._normalise = auto_orient_and_center_poses(
                poses, method="up", center_method="poses"
            )
            self._scale = 1.0 / float(oriented[:, :3, 3].abs().max())

    def of(self, view: View) -> Any:
        """Camera-to-world (3, 4) in the frame the model lives in."""
        import torch

        pose = self._normalise @ torch.from_numpy(view.T_world_camera).float()
        pose[:3, 3] *= self._scale
        return pose[:3]


def run(method: str) -> None:
    """Parse the command line, train, score, write the JSON."""
    options = parser(f"nerfstudio's {method} in plain torch on the CPU")
    options.add_argument("--rays", type=int, default=None, help="a step; default: nerfstudio's own 4096")
    given = options.parse_args()
    _load_nerfstudio()
    import torch

    torch.set_num_threads(given.threads)
    scene = scene_of(given)
    measure(NerfstudioMethod(method, scene, given.rays, given.seed), scene, given).finish(given.out)
