// SPDX-License-Identifier: Apache-2.0
import tseslint from "typescript-eslint";

export default tseslint.config(
  { ignores: ["dist/", "build-tests/"] },
  {
    files: ["src/**/*.ts"],
    extends: [tseslint.configs.strictTypeChecked],
    languageOptions: { parserOptions: { projectService: true, tsconfigRootDir: import.meta.dirname } },
    rules: {
      "@typescript-eslint/restrict-template-expressions": ["error", { allowNumber: true }],
      // A number that is an index within the bounds of a typed array is asserted where the bounds are known.
      "@typescript-eslint/no-non-null-assertion": "off",
      "no-restricted-properties": [
        "error",
        { property: "innerHTML", message: "Names come from servers: use textContent." },
        { property: "outerHTML", message: "Names come from servers: use textContent." },
        { property: "insertAdjacentHTML", message: "Names come from servers: use textContent." },
      ],
      "max-lines": ["error", 500],
      "max-lines-per-function": ["error", 60],
    },
  },
);
