"""What a recipe may say about pictures."""

from pydantic import Field

from bagassets.recipe.model_base import ChannelName, Model

__all__ = ["Preview"]


class Preview(Model):
    """Pictures of each recording for people: in the web UI, on disk and in `bagassets report`."""

    enabled: bool = Field(True, description="Make them.")
    camera: ChannelName | None = Field(
        None, description="Camera of the single pictures; default: CAM_FRONT, else the first of the rig."
    )
    lidar: ChannelName | None = Field(
        None, description="Lidar of the pictures; default: LIDAR_TOP, else the first of the rig."
    )
    columns: int = Field(6, ge=1, le=24, description="Moments in time on the contact sheet.")
    width: int = Field(1280, ge=320, le=3840, description="Width of each picture in pixels.")
    future_s: float = Field(
        4.0, gt=0, description="How much of the way ahead is drawn into the front image, in seconds."
    )
    range_m: float | None = Field(
        None,
        gt=0,
        description="Half the side of the bird's-eye view; default: as far as most points are, 10 to 50 m.",
    )
    trajectory_map: bool = Field(True, description="Make the map of all recordings (`trajectory_map`).")
