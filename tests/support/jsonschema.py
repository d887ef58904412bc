# SPDX-License-Identifier: MIT
"""As much of JSON schema as ours has."""

TYPES = {
    "string": str,
    "boolean": bool,
    "integer": int,
    "number": (int, float),
    "array": list,
    "object": dict,
}
UNDERSTOOD = {
    *("$schema", "$defs", "$ref", "title", "description", "default", "examples", "type", "const"),
    *("enum", "anyOf", "properties", "additionalProperties", "required", "items", "minItems"),
    *("maxItems", "minimum", "maximum", "minLength", "maxLength", "pattern", "exclusiveMinimum"),
}


def problems(schema, value, root=None, place=""):
    """What is wrong with a value, sentences by place; [] if nothing."""
    root = root or schema
    assert schema.keys() <= UNDERSTOOD, schema.keys() - UNDERSTOOD
    if "$ref" in schema:
        found = problems(root["$defs"][schema["$ref"].rpartition("/")[2]], value, root, place)
        if found:
            return found
    if "anyOf" in schema:
        every = [problems(one, value, root, place) for one in schema["anyOf"]]
        return min(every, key=len)
    kind = TYPES.get(schema.get("type"))
    if kind and (not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool)):
        return [f"{place}: no {schema['type']}"]
    for key, wrong in (
        ("const", lambda told: value != told),
        ("enum", lambda told: value not in told),
        ("minimum", lambda told: value < told),
        ("maximum", lambda told: value > told),
        ("minItems", lambda told: len(value) < told),
        ("maxItems", lambda told: len(value) > told),
        ("minLength", lambda told: len(value) < told),
        ("maxLength", lambda told: len(value) > told),
        ("required", lambda told: not set(told) <= value.keys()),
    ):
        if key in schema and wrong(schema[key]):
            return [f"{place}: not {key} {schema[key]}"]
    found = []
    if isinstance(value, list) and isinstance(schema.get("items"), dict):
        for i, item in enumerate(value):
            found += problems(schema["items"], item, root, f"{place}[{i}]")
    if isinstance(value, dict):
        known, rest = schema.get("properties", {}), schema.get("additionalProperties", True)
        for key, item in value.items():
            if key in known:
                found += problems(known[key], item, root, f"{place}.{key}")
            elif isinstance(rest, dict):
                found += problems(rest, item, root, f"{place}.{key}")
            elif not rest:
                found.append(f"{place}: unknown {key}")
    return found
