"""The command line: one command for the whole pipeline and one per stage.

Everything heavy is imported inside the commands, so that `envcal --help` answers at once.
"""

from envcal.cli import pipeline, renderers, stages
from envcal.cli.group import main
from envcal.cli.options import INDOOR, SPACES, STAGE_NAMES

__all__ = ["INDOOR", "SPACES", "STAGE_NAMES", "main", "pipeline", "renderers", "stages"]
