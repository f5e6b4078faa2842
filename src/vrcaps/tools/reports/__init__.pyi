from .coverage import EpisodeCoverage as EpisodeCoverage
from .coverage import episode_coverage as episode_coverage
from .coverage import write_coverage_figure as write_coverage_figure
from .coverage import write_coverage_mesh as write_coverage_mesh
from .coverage import write_coverage_table as write_coverage_table
from .overview import write_overview as write_overview
