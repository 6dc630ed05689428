"""From files to `Photos`: the one image decoder, what EXIF says, and poses the input carries."""

from graphgs.sources.config import SourcesConfig
from graphgs.sources.load import load_photos
from graphgs.sources.photos import Photo, Photos, Skipped
from graphgs.sources.poses import read_poses
from graphgs.sources.scan import Scan, fingerprint, scan

__all__ = ["Photo", "Photos", "Scan", "Skipped", "SourcesConfig", "fingerprint", "load_photos", "read_poses", "scan"]
