// Khronos's own glTF validator over files; ends with 1 where one has an error or a warning.
//
//   npm install gltf-validator && node tools/validate_gltf.js FILE.glb ...
//
// It does not know MPEG_haptic_material, and says so; tests/core/glb_rules.py has the rules of that extension.
const fs = require("fs");
const validator = require(require.resolve("gltf-validator", { paths: [process.cwd()] }));

async function main(files) {
  let bad = files.length ? 0 : 1;
  for (const file of files) {
    const { issues } = await validator.validateBytes(new Uint8Array(fs.readFileSync(file)));
    console.log(`${file}: ${issues.numErrors} errors, ${issues.numWarnings} warnings`);
    for (const each of issues.messages) console.log(`  ${each.code} ${each.pointer || ""}: ${each.message}`);
    bad += issues.numErrors + issues.numWarnings;
  }
  process.exitCode = bad ? 1 : 0;
}

main(process.argv.slice(2));
