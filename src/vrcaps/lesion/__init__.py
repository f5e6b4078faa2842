"""Lesions: shapes and patterns added to an organ's wall, each an instance with a grade.

A kind of lesion is a subclass of `Lesion` with a `kind`, in the table `LESIONS` or in a plug-in.
The command line, scenario files, library and tables in the docs follow from it.
"""

from vrcaps.lesion.add import LesionPair as LesionPair
from vrcaps.lesion.add import add_lesions as add_lesions
from vrcaps.lesion.add import lesion_rng as lesion_rng
from vrcaps.lesion.base import LESIONS as LESIONS
from vrcaps.lesion.base import Lesion as Lesion
from vrcaps.lesion.base import Location as Location
from vrcaps.lesion.bleeding import Bleeding as Bleeding
from vrcaps.lesion.colitis import Colitis as Colitis
from vrcaps.lesion.library import draw_lesions as draw_lesions
from vrcaps.lesion.library import lesion_library as lesion_library
from vrcaps.lesion.library import parse_lesion as parse_lesion
from vrcaps.lesion.mucosal import Angioectasia as Angioectasia
from vrcaps.lesion.mucosal import Erosion as Erosion
from vrcaps.lesion.mucosal import Lymphangiectasia as Lymphangiectasia
from vrcaps.lesion.mucosal import Ulcer as Ulcer
from vrcaps.lesion.polyp import Polyp as Polyp
from vrcaps.lesion.structural import Diverticulum as Diverticulum
from vrcaps.lesion.structural import Stricture as Stricture
from vrcaps.lesion.structural import Tumor as Tumor
