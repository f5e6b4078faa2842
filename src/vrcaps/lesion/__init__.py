"""Lesions: real shapes and patterns put into an organ's wall, each an instance with a grade."""

from vrcaps.lesion.add import LesionPair as LesionPair
from vrcaps.lesion.add import add_lesions as add_lesions
from vrcaps.lesion.base import Lesion as Lesion
from vrcaps.lesion.base import Location as Location
from vrcaps.lesion.bleeding import Bleeding as Bleeding
from vrcaps.lesion.colitis import Colitis as Colitis
from vrcaps.lesion.polyp import Polyp as Polyp
from vrcaps.lesion.prevalence import draw_lesions as draw_lesions
from vrcaps.lesion.registry import LESIONS as LESIONS
from vrcaps.lesion.registry import LIBRARY as LIBRARY
from vrcaps.lesion.registry import AnyLesion as AnyLesion
from vrcaps.lesion.registry import parse_lesion as parse_lesion
from vrcaps.lesion.structural import Diverticulum as Diverticulum
from vrcaps.lesion.structural import Stricture as Stricture
from vrcaps.lesion.structural import Tumor as Tumor
from vrcaps.lesion.ulcer import Erosion as Erosion
from vrcaps.lesion.ulcer import Ulcer as Ulcer
from vrcaps.lesion.vascular import Angioectasia as Angioectasia
from vrcaps.lesion.vascular import Lymphangiectasia as Lymphangiectasia
