"""What the fields of every config section share: ranges, finite numbers, and no unknown key."""

from typing import Annotated

from pydantic import ConfigDict, Field

Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]
Probability = Annotated[float, Field(ge=0, le=1)]
Vector3 = tuple[float, float, float]
Seed = Annotated[int, Field(ge=0, lt=1 << 63)]
STRICT = ConfigDict(extra="forbid", allow_inf_nan=False)
