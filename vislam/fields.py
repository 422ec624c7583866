"""What the fields of every config section share: ranges, and that an unknown key is an error."""

from typing import Annotated

from pydantic import ConfigDict, Field

Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]
Probability = Annotated[float, Field(ge=0, le=1)]
Vector3 = tuple[float, float, float]
STRICT = ConfigDict(extra="forbid")
