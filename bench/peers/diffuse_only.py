#!/usr/bin/env python3
"""Write a copy of a GLB in which every material is Lambert with its base colour, alpha and emission kept.

  diffuse_only.py IN.glb OUT.glb

Dielectrics of glTF have a specular layer that closed forms and simple renderers leave out; this turns it off.
"""
import json
import struct
import sys

with open(sys.argv[1], "rb") as f:
    data = f.read()
length = struct.unpack_from("<I", data, 12)[0]
scene, rest = json.loads(data[20:20 + length]), data[20 + length:]
keep = ("KHR_materials_emissive_strength", "KHR_texture_transform")
for material in scene.get("materials", []):
    pbr = material.setdefault("pbrMetallicRoughness", {})
    pbr.pop("metallicRoughnessTexture", None)
    pbr.update(metallicFactor=0.0, roughnessFactor=1.0)
    material.pop("normalTexture", None)
    extensions = {k: v for k, v in material.get("extensions", {}).items() if k in keep}
    material["extensions"] = {**extensions, "KHR_materials_specular": {"specularFactor": 0.0}}
gone = {"KHR_materials_" + n for n in ("transmission", "ior", "volume", "clearcoat", "sheen")}
scene["extensionsUsed"] = sorted(set(scene.get("extensionsUsed", [])) - gone | {"KHR_materials_specular"})
scene["extensionsRequired"] = sorted(set(scene.get("extensionsRequired", [])) - gone)
if not scene["extensionsRequired"]:
    del scene["extensionsRequired"]
text = json.dumps(scene).encode()
text += b" " * (-len(text) % 4)
with open(sys.argv[2], "wb") as f:
    f.write(struct.pack("<4sIIII", b"glTF", 2, 20 + len(text) + len(rest), len(text), 0x4E4F534A) + text + rest)
