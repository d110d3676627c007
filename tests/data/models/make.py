#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Writes the model files of this folder, for client/model_intake. Each is a box of 1 x 2 x 3 cm with one corner at the origin, in the
unit and with the transformations that its format has; those named label_* have a dark square on the face z = 3 cm, a quarter of the face
away from its edges.

  make.py [DIRECTORY]

It does not write label_box_draco.gltf, which draco_transcoder of the Debian package draco (1.5.5) made of label_box.gltf:
  draco_transcoder -i label_box.gltf -o label_box_draco.gltf -qp 24 -qn 16 -qt 14
Its buffer was then moved into the file, as a data URI.
"""
import base64
import json
import pathlib
import struct
import sys
import zipfile
import zlib

SIZE_M = (0.01, 0.02, 0.03)
CORNERS = [tuple(SIZE_M[axis] * (i >> axis & 1) for axis in range(3)) for i in range(8)]
QUADS = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
TRIANGLES = [t for a, b, c, d in QUADS for t in ((a, b, c), (a, c, d))]
PIXELS = 64


def png():
    rows = b"".join(b"\0" + bytes(30 if 16 <= x < 48 and 16 <= y < 48 else 230 for x in range(PIXELS)) for y in range(PIXELS))
    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
    return (b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", struct.pack(">IIBBBBB", PIXELS, PIXELS, 8, 0, 0, 0, 0)) +
            chunk(b"IDAT", zlib.compress(rows, 9)) + chunk(b"IEND", b""))


def off():
    points = "".join("%g %g %g\n" % tuple(100 * x for x in corner) for corner in CORNERS)
    return "OFF\n8 6 0\n" + points + "".join("4 %d %d %d %d\n" % quad for quad in QUADS)


def dae():
    # Half of the size in centimetres; the node doubles it. The z axis is up, which must not turn the model.
    points = " ".join("%g %g %g" % tuple(50 * x for x in corner) for corner in CORNERS)
    indices = " ".join("%d %d %d" % triangle for triangle in TRIANGLES)
    return f"""<?xml version="1.0" encoding="utf-8"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
  <asset><unit name="centimeter" meter="0.01"/><up_axis>Z_UP</up_axis></asset>
  <library_geometries><geometry id="box"><mesh>
    <source id="p"><float_array id="pa" count="24">{points}</float_array><technique_common>
      <accessor source="#pa" count="8" stride="3"><param name="X" type="float"/><param name="Y" type="float"/><param name="Z" type="float"/></accessor>
    </technique_common></source>
    <vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
    <triangles count="12"><input semantic="VERTEX" source="#v" offset="0"/><p>{indices}</p></triangles>
  </mesh></geometry></library_geometries>
  <library_visual_scenes><visual_scene id="s"><node id="n"><scale>2 2 2</scale><instance_geometry url="#box"/></node></visual_scene></library_visual_scenes>
  <scene><instance_visual_scene url="#s"/></scene>
</COLLADA>
"""


def three_mf(path, unit, metres):
    """`unit` None: the attribute is absent."""
    vertices = "".join('<vertex x="%.9g" y="%.9g" z="%.9g"/>' % tuple(x / metres for x in corner) for corner in CORNERS)
    triangles = "".join('<triangle v1="%d" v2="%d" v3="%d"/>' % triangle for triangle in TRIANGLES)
    attribute = f' unit="{unit}"' if unit else ""
    model = (f'<?xml version="1.0" encoding="UTF-8"?>\n<model{attribute} xml:lang="en-US" '
             'xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02"><resources><object id="1" type="model"><mesh>'
             f"<vertices>{vertices}</vertices><triangles>{triangles}</triangles></mesh></object></resources>"
             '<build><item objectid="1"/></build></model>')
    rels = ('<?xml version="1.0" encoding="UTF-8"?>\n<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships">'
            '<Relationship Target="/3D/3dmodel.model" Id="rel0" Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"/></Relationships>')
    types = ('<?xml version="1.0" encoding="UTF-8"?>\n<Types xmlns="http://schemas.openxmlformats.org/package/2006/content-types">'
             '<Default Extension="rels" ContentType="application/vnd.openxmlformats-package.relationships+xml"/>'
             '<Default Extension="model" ContentType="application/vnd.ms-package.3dmanufacturing-3dmodel+xml"/></Types>')
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, text in (("[Content_Types].xml", types), ("_rels/.rels", rels), ("3D/3dmodel.model", model)):
            archive.writestr(zipfile.ZipInfo(name), text, zipfile.ZIP_DEFLATED)


def gltf_parts():
    """The binary buffer, without and with the image, and the JSON without the place of the buffer. Each face has four points of its own,
    with normals; only the face z = 3 cm has the image."""
    positions, normals, uvs, plain, labelled = [], [], [], [], []
    for number, quad in enumerate(QUADS):
        first = len(positions)
        normal = [0.0, 0.0, 0.0]
        normal[(2, 2, 1, 1, 0, 0)[number]] = (-1.0, 1.0)[number % 2]
        for corner, uv in zip(quad, ((0, 1), (1, 1), (1, 0), (0, 0))):
            # The node mirrors x and doubles all lengths.
            positions.append((-CORNERS[corner][0] / 2, CORNERS[corner][1] / 2, CORNERS[corner][2] / 2))
            normals.append((-normal[0], normal[1], normal[2]))
            uvs.append(uv)
        indices = (labelled if number == 1 else plain)
        indices += [first, first + 2, first + 1, first, first + 3, first + 2]  # mirrored back by the node
    parts = [b"".join(struct.pack("<3f", *p) for p in positions), b"".join(struct.pack("<3f", *n) for n in normals),
             b"".join(struct.pack("<2f", *uv) for uv in uvs), struct.pack("<%dH" % len(plain), *plain),
             struct.pack("<%dH" % len(labelled), *labelled)]
    views, buffer = [], b""
    for part in parts:
        views.append({"buffer": 0, "byteOffset": len(buffer), "byteLength": len(part)})
        buffer += part + b"\0" * (-len(part) % 4)
    low = [min(p[axis] for p in positions) for axis in range(3)]
    high = [max(p[axis] for p in positions) for axis in range(3)]
    attributes = {"POSITION": 0, "NORMAL": 1, "TEXCOORD_0": 2}
    document = {
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0, "scale": [-2, 2, 2]}],
        "meshes": [{"primitives": [{"attributes": attributes, "indices": 3, "material": 0},
                                   {"attributes": attributes, "indices": 4, "material": 1}]}],
        "materials": [{}, {"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}],
        "textures": [{"source": 0}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 24, "type": "VEC3", "min": low, "max": high},
                      {"bufferView": 1, "componentType": 5126, "count": 24, "type": "VEC3"},
                      {"bufferView": 2, "componentType": 5126, "count": 24, "type": "VEC2"},
                      {"bufferView": 3, "componentType": 5123, "count": len(plain), "type": "SCALAR"},
                      {"bufferView": 4, "componentType": 5123, "count": len(labelled), "type": "SCALAR"}],
        "bufferViews": views}
    return buffer, document


def gltf():
    buffer, document = gltf_parts()
    document["images"] = [{"uri": "label.png"}]
    document["buffers"] = [{"byteLength": len(buffer), "uri": "data:application/octet-stream;base64," + base64.b64encode(buffer).decode()}]
    return json.dumps(document)


def glb():
    buffer, document = gltf_parts()
    image = png()
    document["images"] = [{"bufferView": len(document["bufferViews"]), "mimeType": "image/png"}]
    document["bufferViews"].append({"buffer": 0, "byteOffset": len(buffer), "byteLength": len(image)})
    buffer += image + b"\0" * (-len(image) % 4)
    document["buffers"] = [{"byteLength": len(buffer)}]
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(buffer), b"BIN\0") + buffer
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def obj():
    points = "".join("v %g %g %g\n" % corner for corner in CORNERS)
    lines = ["f %d %d %d %d\n" % tuple(i + 1 for i in quad) for quad in QUADS]
    lines[1] = "usemtl label\nf " + " ".join("%d/%d" % (i + 1, k + 1) for k, i in enumerate(QUADS[1])) + "\nusemtl plain\n"
    return "mtllib label.mtl\n" + points + "vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nusemtl plain\n" + "".join(lines)


def main():
    folder = pathlib.Path(sys.argv[1] if len(sys.argv) > 1 else pathlib.Path(__file__).parent)
    (folder / "box.off").write_text(off())
    (folder / "box.dae").write_text(dae())
    three_mf(folder / "box.3mf", None, 1e-3)
    three_mf(folder / "box_inch.3mf", "inch", 0.0254)
    three_mf(folder / "box_parsec.3mf", "parsec", 3.0857e16)
    (folder / "label.png").write_bytes(png())
    (folder / "label_box.gltf").write_text(gltf())
    (folder / "label_box.glb").write_bytes(glb())
    (folder / "label_box.obj").write_text(obj())
    (folder / "label.mtl").write_text("newmtl plain\nKd 1 1 1\nnewmtl label\nKd 1 1 1\nmap_Kd label.png\n")


if __name__ == "__main__":
    main()
