/** What can be wrong with a placement database. The names are those of `farfield.errors`; `code` is the stable one
 * (minifying renames classes). */

export class PlacementFileError extends Error {
  readonly advice: string = "Fetch the placement again, or place the level again.";
  readonly code: string = "PlacementFileError";
  readonly where: string;
  constructor(where: string, message: string) {
    super(message);
    this.where = where;
  }
}

export class NotColumns extends PlacementFileError {
  override readonly code = "NotColumns";
  constructor(where: string) {
    super(where, `${where} is not a farfield file: it does not begin with FARFIELD.`);
  }
}

export class ColumnsTooNew extends PlacementFileError {
  override readonly code = "ColumnsTooNew";
  override readonly advice = "Update farfield.";
  constructor(where: string, found: number, known: number) {
    super(where, `${where} has format version ${found}; this farfield reads version ${known}.`);
  }
}

export class ColumnsTruncated extends PlacementFileError {
  override readonly code = "ColumnsTruncated";
  constructor(where: string, foundBytes: number, neededBytes: number) {
    super(where, `${where} is truncated: ${foundBytes} of at least ${neededBytes} bytes are there.`);
  }
}

export class ColumnsAltered extends PlacementFileError {
  override readonly code = "ColumnsAltered";
  constructor(where: string, why: string) {
    super(where, `${where} is altered or damaged: ${why}.`);
  }
}

export class PlacementFileMissing extends PlacementFileError {
  override readonly code = "PlacementFileMissing";
  constructor(where: string) {
    super(where, `${where} is missing.`);
  }
}

export class OutsideViewSpace extends Error {
  readonly code = "OutsideViewSpace";
  readonly advice = "Clamp the camera to the boxes in the manifest's view_space.";
  constructor(position: ArrayLike<number>) {
    super(`position ${Array.from(position).join(", ")} lies outside the view space.`);
  }
}

export class DirectionInvalid extends Error {
  readonly code = "DirectionInvalid";
  readonly advice = "Give a direction of any length but 0.";
  constructor(direction: ArrayLike<number>) {
    super(`direction ${Array.from(direction).join(", ")} has length 0 or is not finite.`);
  }
}
