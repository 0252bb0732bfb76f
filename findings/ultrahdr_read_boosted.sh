#!/usr/bin/env bash
# OpenImageIO opens a phone's JPEG that has a gain map as a linear HDR picture, not as the JPEG.
# One would guess: a JPEG is read as 8 bits a channel, three channels, encoded as it is stored, as
# Pillow reads it; what a gain map would add is asked for (the hint "jpeg:ultrahdr" is there for that).
# Seen with OpenImageIO 3.2.2.0 from the package registry: with a gain map in it, the file is half
# floats, four channels, already linear, and brightened by the map; with "jpeg:ultrahdr" 0 as well. The
# base picture's middle, 0.242 linear, is read as 0.5. Without the map the same file is 8 bits.
# Where: src/jpeg.imageio/jpeginput.cpp, read_uhdr().
# Users of isas: Pixel and Galaxy phones write such files by default; in a set of photographs some
# have a map and others none, and each map is another one. isas reads the base picture.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3}" -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip --disable-pip-version-check install --quiet OpenImageIO==3.2.2.0 pillow==12.3.0 numpy==2.2.6
cd "$folder"
cat > try.py <<'END'
import io
import struct

import numpy as np
import OpenImageIO as oiio
from PIL import Image

SIDE = 128
XMP = b"http://ns.adobe.com/xap/1.0/\0"
GAIN = (b'hdrgm:Version="1.0" hdrgm:GainMapMin="0" hdrgm:GainMapMax="2" hdrgm:Gamma="1" '
        b'hdrgm:OffsetSDR="0.015625" hdrgm:OffsetHDR="0.015625" hdrgm:HDRCapacityMin="0" '
        b'hdrgm:HDRCapacityMax="2" hdrgm:BaseRenditionIsHDR="False"')


def jpeg(pixels):
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, "JPEG", quality=95)
    return buffer.getvalue()


def segment(marker, content):
    return struct.pack(">BBH", 0xFF, marker, len(content) + 2) + content


def described(attributes, inside=b""):
    return XMP + (
        b'<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF '
        b'xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#"><rdf:Description '
        b'xmlns:hdrgm="http://ns.adobe.com/hdr-gain-map/1.0/" '
        b'xmlns:Container="http://ns.google.com/photos/1.0/container/" '
        b'xmlns:Item="http://ns.google.com/photos/1.0/container/item/" '
        + attributes + b">" + inside + b"</rdf:Description></rdf:RDF></x:xmpmeta>")


def item(what, more=b""):
    return (b'<rdf:li rdf:parseType="Resource"><Container:Item Item:Semantic="' + what
            + b'" Item:Mime="image/jpeg"' + more + b"/></rdf:li>")


def listed(size, offset, length):
    """The multi-picture index: both pictures with their sizes, the second with its offset."""
    entries = struct.pack("<IIIHH", 0x30000, size, 0, 0, 0)
    entries += struct.pack("<IIIHH", 0, length, offset, 0, 0)
    tags = struct.pack("<HHI4s", 0xB000, 7, 4, b"0100") + struct.pack("<HHII", 0xB001, 4, 1, 2)
    tags += struct.pack("<HHII", 0xB002, 7, 32, 8 + 2 + 36 + 4)
    return b"MPF\0II*\0" + struct.pack("<IH", 8, 3) + tags + struct.pack("<I", 0) + entries


ramp = np.tile(np.linspace(20, 250, SIDE).astype(np.uint8), (SIDE, 1))
base = jpeg(np.stack([ramp, ramp // 2, 255 - ramp], -1))
gains = jpeg(np.tile(np.linspace(0, 255, SIDE // 4).astype(np.uint8), (SIDE // 4, 1)))
gains = gains[:2] + segment(0xE1, described(GAIN)) + gains[2:]
more = b' Item:Length="%d"' % len(gains)
directory = b"<Container:Directory><rdf:Seq>" + item(b"Primary") + item(b"GainMap", more)
said = described(b'hdrgm:Version="1.0"', directory + b"</rdf:Seq></Container:Directory>")
head = base[:2] + segment(0xE1, said)
index = segment(0xE2, listed(0, 0, 0))
size = len(head) + len(index) + len(base) - 2
index = segment(0xE2, listed(size, size - len(head) - 8, len(gains)))
open("plain.jpg", "wb").write(base)
open("gained.jpg", "wb").write(head + index + base[2:] + gains)
assert np.array_equal(*(np.asarray(Image.open(f"{n}.jpg")) for n in ("plain", "gained")))
print("Pillow: the same 8 bits of both")


def opened(name, hint=None):
    config = oiio.ImageSpec()
    if hint is not None:
        config.attribute("jpeg:ultrahdr", hint)
    source = oiio.ImageInput.open(f"{name}.jpg", config)
    spec = source.spec()
    found = str(spec.format), spec.nchannels, source.read_image(oiio.FLOAT)[SIDE // 2, SIDE // 2, 0]
    print(f"OpenImageIO {oiio.VERSION_STRING}, {name}, hint {hint}: {found}")
    return found


plain, gained, asked = opened("plain"), opened("gained"), opened("gained", 0)
linear = ((plain[2] + 0.055) / 1.055) ** 2.4
print(f"the plain one's middle is {linear:.3f} linear")
if not (plain[:2] == ("uint8", 3) and gained == asked and gained[:2] == ("half", 4)
        and 1.5 < gained[2] / linear < 3):
    raise SystemExit("changed: with OpenImageIO 3.2.2.0 it was half, 4 channels, twice as bright")
END
venv/bin/python try.py
