"""Light for the few things of the page that need any, cheap enough for a browser without a graphics card."""

from viser import SceneApi

_SKY, _GROUND = (255, 255, 255), (170, 170, 170)
_INTENSITY = 3.0  # about pi gives a surface its own colour


def light_cheaply(scene: SceneApi) -> None:
    """Replace viser's photographed surroundings and shadows; call it before anything else.

    Until the surroundings are loaded, viser all but hides the scene: seconds without a graphics card.
    """
    scene.configure_environment_map(None)
    scene.configure_default_lights(False)
    scene.add_light_hemisphere(
        "/light", sky_color=_SKY, ground_color=_GROUND, intensity=_INTENSITY, position=(0.0, 0.0, 1.0)
    )
