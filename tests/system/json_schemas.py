"""Validate the lines of standard input against the JSON schema of the first argument.

Every field has to be described. With the second argument `update` the schema is extended by the fields and types of the
lines first, and is created where it does not exist.
"""

import json
import os
import sys

try:
    import jsonschema
except ImportError:
    sys.exit("jsonschema is missing: install the Debian package python3-jsonschema")

UPDATE = sys.argv[2:] == ["update"]
OPEN = {"anyOf", "additionalProperties", "patternProperties"}  # objects whose keys are data
TYPES = {bool: "boolean", int: "number", float: "number", str: "string", type(None): "null", list: "array", dict: "object"}


def extend(schema, value):
    """Return a schema, or None for a new field, extended by the type and the fields of a value.

    A field that has been null only has no type yet. Which fields are required is a promise, so none is added.
    """
    own = TYPES[type(value)]
    known = ["null"] if schema == {} else (schema or {}).get("type", [])
    known = known if isinstance(known, list) else [known]
    schema = {} if schema is None else schema
    described = {"enum", "const", "anyOf"} & set(schema) or own in known or (own == "number" and "integer" in known)
    if not described and (known or value is not None):
        schema["type"] = [*known, own] if known else own
    if isinstance(value, list):
        for one in value:
            schema["items"] = extend(schema.get("items"), one)
    if isinstance(value, dict) and not (OPEN & set(schema)):
        fields = schema.setdefault("properties", {})
        for key, one in value.items():
            fields[key] = extend(fields.get(key), one)
        if "required" in schema:
            schema["required"] = [key for key in schema["required"] if key in value]
    return schema


def undescribed(schema, value, path):
    """Yield the path of each field of a value that its schema does not describe."""
    if isinstance(value, list):
        for one in value:
            yield from undescribed(schema.get("items", {}), one, path + "[]")
    if isinstance(value, dict) and "anyOf" not in schema:
        others = schema.get("additionalProperties")
        for key, one in value.items():
            own = schema.get("properties", {}).get(key, others)
            if own is None and "patternProperties" not in schema:
                yield path + "." + key
            elif isinstance(own, dict):
                yield from undescribed(own, one, path + "." + key)


def read(path):
    """Read a schema; where there is none, an empty one of the command that the file is named after."""
    if UPDATE and not os.path.exists(path):
        command = os.path.basename(path).removesuffix(".schema.json")
        return {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": f"wingd {command} --json"}
    with open(path, encoding="utf-8") as file:
        return json.load(file)


lines = [json.loads(line) for line in sys.stdin.read().splitlines() if line.strip()]
schema = read(sys.argv[1])
if UPDATE:
    for line in lines:
        schema = extend(schema, line)
    with open(sys.argv[1], "w", encoding="utf-8") as file:
        json.dump(schema, file, indent=1, ensure_ascii=False)
        file.write("\n")
jsonschema.Draft202012Validator.check_schema(schema)
validator = jsonschema.Draft202012Validator(schema)
faults = [
    f"line {k + 1}: {e.json_path}: {e.message[:300]}" for k, line in enumerate(lines) for e in validator.iter_errors(line)
]
faults += [f"not in the schema: {one}" for one in sorted({one for line in lines for one in undescribed(schema, line, "")})]
sys.exit("\n".join(faults) or (0 if lines else "no line"))
