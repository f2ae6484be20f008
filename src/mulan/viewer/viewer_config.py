"""Where the page is served, and how large its pictures are."""

from dataclasses import dataclass, field


@dataclass
class PictureConfig:
    """How large the page's pictures are."""

    moving_side: int = 256
    """Longest side while the camera moves, pixels."""
    still_side: int = 640
    """Longest side once it stands still, pixels."""
    jpeg_quality: int = 80
    """Of the pictures sent to the browser (1-95)."""
    refresh_s: float = 2.0
    """A standing picture of a field that still learns is drawn again after so long."""


@dataclass
class ViewerConfig:
    """Where the page is served, and its pictures."""

    host: str = "127.0.0.1"
    """Address to serve on; 0.0.0.0 lets other computers open the page (anyone who reaches the port can)."""
    port: int = 8080
    """Port; the next free one is taken where it is in use."""
    picture: PictureConfig = field(default_factory=PictureConfig)
    """Size of the pictures."""
