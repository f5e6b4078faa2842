"""Lesions: real shapes and patterns put into an organ's wall, each an instance with a grade."""

from vrcaps.organ.lesion.add import Patient as Patient
from vrcaps.organ.lesion.add import add_lesions as add_lesions
from vrcaps.organ.lesion.base import Lesion as Lesion
from vrcaps.organ.lesion.base import Place as Place
from vrcaps.organ.lesion.breaks import Erosion as Erosion
from vrcaps.organ.lesion.breaks import Ulcer as Ulcer
from vrcaps.organ.lesion.colitis import Colitis as Colitis
from vrcaps.organ.lesion.haemorrhage import Haemorrhage as Haemorrhage
from vrcaps.organ.lesion.polyp import Polyp as Polyp
from vrcaps.organ.lesion.prevalence import draw_lesions as draw_lesions
from vrcaps.organ.lesion.registry import LESIONS as LESIONS
from vrcaps.organ.lesion.registry import LIBRARY as LIBRARY
from vrcaps.organ.lesion.registry import AnyLesion as AnyLesion
from vrcaps.organ.lesion.registry import parse_lesion as parse_lesion
from vrcaps.organ.lesion.solid import Diverticulum as Diverticulum
from vrcaps.organ.lesion.solid import Stricture as Stricture
from vrcaps.organ.lesion.solid import Tumour as Tumour
from vrcaps.organ.lesion.vascular import Angioectasia as Angioectasia
from vrcaps.organ.lesion.vascular import Lymphangiectasia as Lymphangiectasia
