"""A document as PDF/A-3 (ISO 19005-3, level B): metadata, colours and attachments that will be read in decades."""

import io
from dataclasses import dataclass
from datetime import UTC, datetime, time

import pikepdf
from PIL import ImageCms

from softcal.app.export.certificates.parts import Document


@dataclass(frozen=True)
class Attachment:
    """A file inside a document that holds the same facts in another form."""

    name: str
    content: bytes
    description: str


def archival(content: bytes, page: Document, attached: Attachment | None = None) -> bytes:
    """Return a PDF as PDF/A-3, with a file inside where one is given: the same bytes for the same facts."""
    made_at = datetime.combine(page.made_on, time(), UTC)
    result = io.BytesIO()
    with pikepdf.open(io.BytesIO(content)) as pdf:
        _describe(pdf, page, made_at)
        _colours(pdf)
        if attached is not None:
            _attach(pdf, attached, made_at)
        pdf.save(result, deterministic_id=True, object_stream_mode=pikepdf.ObjectStreamMode.disable)
    return result.getvalue()


def _describe(pdf: pikepdf.Pdf, page: Document, made_at: datetime) -> None:
    """Write the metadata twice, as XMP and in the old dictionary: a reader may look at either, and they must agree."""
    stamp = f"D:{made_at:%Y%m%d%H%M%S}+00'00'"
    told = {"/Title": page.title, "/Author": page.author, "/Creator": page.software, "/Producer": page.software}
    with pdf.open_metadata(set_pikepdf_as_editor=False, update_docinfo=False) as metadata:
        metadata["dc:title"] = page.title
        metadata["dc:creator"] = [page.author]
        metadata["xmp:CreatorTool"] = page.software
        metadata["pdf:Producer"] = page.software
        metadata["xmp:CreateDate"] = metadata["xmp:ModifyDate"] = made_at.isoformat()
        metadata["pdfaid:part"], metadata["pdfaid:conformance"] = "3", "B"
    for key in list(pdf.docinfo.keys()):
        del pdf.docinfo[key]
    for key, value in {**told, "/CreationDate": stamp, "/ModDate": stamp}.items():
        pdf.docinfo[key] = value


def _colours(pdf: pikepdf.Pdf) -> None:
    """State what the colours mean: sRGB."""
    profile = bytearray(ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes())
    profile[24:36] = bytes(12)  # the moment it was made: the same facts must give the same bytes
    profile[84:100] = bytes(16)  # its checksum, which would hold for that moment
    stream = pdf.make_stream(bytes(profile), N=3, Alternate=pikepdf.Name.DeviceRGB)
    intent = pikepdf.Dictionary(
        Type=pikepdf.Name.OutputIntent,
        S=pikepdf.Name.GTS_PDFA1,
        OutputConditionIdentifier="sRGB",
        Info="sRGB IEC61966-2.1",
        DestOutputProfile=stream,
    )
    pdf.Root.OutputIntents = pikepdf.Array([pdf.make_indirect(intent)])


def _attach(pdf: pikepdf.Pdf, attached: Attachment, made_at: datetime) -> None:
    file = pikepdf.AttachedFileSpec(
        pdf,
        attached.content,
        filename=attached.name,
        description=attached.description,
        mime_type="text/xml",
        creation_date=f"D:{made_at:%Y%m%d%H%M%S}+00'00'",
        mod_date=f"D:{made_at:%Y%m%d%H%M%S}+00'00'",
    )
    file.obj.AFRelationship = pikepdf.Name.Alternative
    pdf.attachments[attached.name] = file
    pdf.Root.AF = pikepdf.Array([file.obj])
